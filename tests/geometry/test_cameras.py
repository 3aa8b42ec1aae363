from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vo.geometry.cameras import distort, normalise, project
from vo.geometry.distortion import reach
from vo.types import Camera, Floats

CAMERAS = {
    "pinhole": Camera(640, 480, 500.0, 510.0, 320.5, 238.0),
    "radtan4": Camera(
        752, 480, 458.654, 457.296, 367.215, 248.375,
        "radtan", (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05),
    ),
    "radtan5_strong": Camera(
        1392, 512, 984.2439, 980.8141, 690.0, 233.1966,
        "radtan", (-0.3728755, 0.2037299, 0.002219027, 0.001383707, -0.07233722),
    ),
    "radtan5_pincushion": Camera(
        640, 480, 517.3, 516.5, 318.6, 255.3,
        "radtan", (0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    ),
    "radtan8": Camera(
        2048, 1536, 976.0, 976.0, 1024.0, 767.0,
        "radtan", (0.45, -0.0195, 1e-4, -1e-4, 0.0004, 0.79, 0.03, -0.004),
    ),
    "equidistant": Camera(
        512, 512, 190.978, 190.973, 254.93, 256.9,
        "equidistant", (0.0034823894, 0.000715034, -0.0020532361, 0.00020293673),
    ),
}  # fmt: skip

each_camera = pytest.mark.parametrize("name", CAMERAS)


def _image_grid(camera: Camera) -> Floats:
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 80), np.linspace(0, camera.height - 1, 60))
    return np.column_stack([u.ravel(), v.ravel()])


def _rays_within(camera: Camera, count: int = 500) -> Floats:
    limit = reach(camera) if camera.distortion_model == "radtan" else 1.4
    radius = min(0.95 * limit, np.tan(1.4) if camera.distortion_model == "equidistant" else 1.1)
    rng = np.random.default_rng(1)
    angle, length = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])


@each_camera
def test_distorting_a_normalised_pixel_gives_it_back(name: str) -> None:
    camera = CAMERAS[name]
    pixels = _image_grid(camera)
    rays = normalise(camera, pixels)
    seen = np.isfinite(rays).all(axis=1)
    if camera.distortion_model != "equidistant":
        assert seen.all()
    assert np.abs(distort(camera, rays) - pixels)[seen].max() < 1e-9


@each_camera
def test_normalising_a_distorted_ray_gives_it_back(name: str) -> None:
    camera = CAMERAS[name]
    rays = _rays_within(camera)
    np.testing.assert_allclose(normalise(camera, distort(camera, rays)), rays, atol=1e-9, rtol=1e-9)


@each_camera
def test_agrees_with_opencv(name: str) -> None:
    camera = CAMERAS[name]
    rays = _rays_within(camera)
    points = np.column_stack([rays, np.ones(len(rays))]).reshape(-1, 1, 3)
    coefficients = np.array(camera.distortion) if camera.distortion else np.zeros(4)
    zero = np.zeros((3, 1))
    if camera.distortion_model == "equidistant":
        expected, _ = cv2.fisheye.projectPoints(points, zero, zero, camera.matrix, coefficients)
    else:
        expected, _ = cv2.projectPoints(points, zero, zero, camera.matrix, coefficients)
    np.testing.assert_allclose(distort(camera, rays), expected.reshape(-1, 2), atol=1e-9)


@given(
    k1=st.floats(-0.4, 0.4),
    k2=st.floats(-0.2, 0.2),
    k3=st.floats(-0.1, 0.1),
    p1=st.floats(-0.003, 0.003),
    p2=st.floats(-0.003, 0.003),
)
def test_any_plausible_radtan_lens_can_be_inverted(
    k1: float, k2: float, k3: float, p1: float, p2: float
) -> None:
    camera = Camera(1280, 960, 800.0, 800.0, 640.0, 480.0, "radtan", (k1, k2, p1, p2, k3))
    radius = min(0.9 * reach(camera), 1.0)
    angle = np.linspace(0, 2 * np.pi, 40)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    rays = np.concatenate([ring * radius * share for share in (0.0, 0.1, 0.5, 0.8, 1.0)])
    np.testing.assert_allclose(normalise(camera, distort(camera, rays)), rays, atol=1e-8)


@given(k=st.tuples(*[st.floats(-0.02, 0.02)] * 4))
def test_any_plausible_fisheye_can_be_inverted(k: tuple[float, float, float, float]) -> None:
    camera = Camera(1000, 1000, 300.0, 300.0, 500.0, 500.0, "equidistant", k)
    angles = np.linspace(0.0, min(0.95 * reach(camera), np.deg2rad(85.0)), 60)
    rays = np.column_stack([np.tan(angles), np.zeros(60)])
    np.testing.assert_allclose(
        np.arctan(normalise(camera, distort(camera, rays))), np.arctan(rays), atol=1e-9
    )


def test_rays_beyond_the_fold_of_the_lens_do_not_fall_into_the_image() -> None:
    camera = CAMERAS["radtan5_strong"]
    assert reach(camera) == pytest.approx(1.196, abs=0.01)
    folded, _ = cv2.projectPoints(
        np.array([[1.6, 0.0, 1.0]]), np.zeros(3), np.zeros(3), camera.matrix,
        np.array(camera.distortion),
    )  # fmt: skip
    assert 0 < folded[0, 0, 0] < camera.width
    assert np.isnan(distort(camera, np.array([[1.6, 0.0]]))).all()


def test_pixels_outside_a_hemisphere_have_no_ray() -> None:
    camera = CAMERAS["equidistant"]
    rays = normalise(camera, np.array([[0.0, 0.0], [254.93, 256.9]]))
    assert np.isnan(rays[0]).all()
    np.testing.assert_allclose(rays[1], [0, 0], atol=1e-12)


def test_fisheye_sees_almost_to_the_side() -> None:
    camera = CAMERAS["equidistant"]
    ray = np.array([[np.tan(np.deg2rad(89.0)), 0.0]])
    found = normalise(camera, distort(camera, ray))
    assert np.rad2deg(np.arctan(found[0, 0])) == pytest.approx(89.0, abs=1e-9)


@each_camera
def test_projects_points_by_their_direction(name: str) -> None:
    camera = CAMERAS[name]
    points = np.array([[0.5, -0.2, 2.0], [0.1, 0.3, 4.0]])
    np.testing.assert_allclose(
        project(camera, points), distort(camera, points[:, :2] / points[:, 2:]), atol=1e-12
    )
    np.testing.assert_allclose(project(camera, 3.0 * points), project(camera, points), atol=1e-9)


@each_camera
def test_no_points_are_no_points(name: str) -> None:
    nothing = np.empty((0, 2))
    assert distort(CAMERAS[name], nothing).shape == (0, 2)
    assert normalise(CAMERAS[name], nothing).shape == (0, 2)


def test_equidistant_without_coefficients_still_bends() -> None:
    camera = Camera(100, 100, 50.0, 50.0, 50.0, 50.0, "equidistant", (0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(
        distort(camera, np.array([[1.0, 0.0]])), [[50.0 + 50.0 * np.pi / 4, 50.0]], atol=1e-12
    )
