from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from vo.base.geometry.cameras import distort, normalise, project
from vo.base.geometry.distortion import angle_reach, centre_scale, radial_reach
from vo.base.types import Camera, Floats

CAMERAS = {
    "pinhole": Camera(640, 480, 500.0, 510.0, 320.5, 238.0),
    "radtan4": Camera(
        752,
        480,
        458.654,
        457.296,
        367.215,
        248.375,
        "radtan",
        (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05),
    ),
    "radtan5_strong": Camera(
        1392,
        512,
        984.2439,
        980.8141,
        690.0,
        233.1966,
        "radtan",
        (-0.3728755, 0.2037299, 0.002219027, 0.001383707, -0.07233722),
    ),
    "radtan5_pincushion": Camera(
        640,
        480,
        517.3,
        516.5,
        318.6,
        255.3,
        "radtan",
        (0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    ),
    "radtan8": Camera(
        2048,
        1536,
        976.0,
        976.0,
        1024.0,
        767.0,
        "radtan",
        (0.45, -0.0195, 1e-4, -1e-4, 0.0004, 0.79, 0.03, -0.004),
    ),
    "equidistant": Camera(
        512,
        512,
        190.978,
        190.973,
        254.93,
        256.9,
        "equidistant",
        (0.0034823894, 0.000715034, -0.0020532361, 0.00020293673),
    ),
    "double_sphere": Camera(
        512,
        512,
        158.28600034966977,
        158.2743455478755,
        254.96116578191653,
        256.8894394501779,
        "double_sphere",
        (-0.17213086034353243, 0.5931177593944744),
    ),
    "double_sphere_half": Camera(640, 480, 350.0, 350.0, 320.0, 240.0, "double_sphere", (0.3, 0.4)),
    "extended_unified": Camera(
        752,
        480,
        460.764,
        459.405,
        365.893,
        249.335,
        "extended_unified",
        (0.5903365915, 1.1274681969),
    ),
    "omni": Camera(
        752,
        480,
        833.006,
        830.345,
        373.850,
        253.749,
        "omni",
        (0.80065662, -0.33518750, 0.13211436, 0.00055967, 0.00057686),
    ),
    "omni_mirror": Camera(800, 600, 420.0, 420.0, 400.0, 300.0, "omni", (1.4, 0.0, 0.0, 0.0, 0.0)),
}
WIDE = ("double_sphere", "double_sphere_half", "extended_unified", "omni", "omni_mirror")
OPENCV = [name for name in CAMERAS if name not in WIDE]
each_wide_camera = pytest.mark.parametrize("name", WIDE)
# fmt: skip

each_camera = pytest.mark.parametrize("name", CAMERAS)


def _image_grid(camera: Camera) -> Floats:
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 80), np.linspace(0, camera.height - 1, 60))
    return np.column_stack([u.ravel(), v.ravel()])


def _rays_within(camera: Camera, count: int = 500) -> Floats:
    if camera.distortion_model == "radtan":
        radius = min(0.95 * radial_reach(camera.distortion), 1.1)
    else:
        radius = 1.1 if camera.distortion_model in ("none", "omni") else np.tan(1.4)
    rng = np.random.default_rng(1)
    angle, length = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])


@each_camera
def test_distort_inverts_normalise(name: str) -> None:
    camera = CAMERAS[name]
    pixels = _image_grid(camera)
    rays = normalise(camera, pixels)
    seen = np.isfinite(rays).all(axis=1)
    if camera.distortion_model in ("none", "radtan"):
        assert seen.all()
    assert seen.mean() > 0.5
    assert np.abs(distort(camera, rays) - pixels)[seen].max() < 1e-9


@each_camera
def test_normalise_inverts_distort(name: str) -> None:
    camera = CAMERAS[name]
    rays = _rays_within(camera)
    np.testing.assert_allclose(normalise(camera, distort(camera, rays)), rays, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("name", OPENCV)
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


@settings(deadline=None)
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
    radius = min(0.9 * radial_reach(camera.distortion), 1.0)
    angle = np.linspace(0, 2 * np.pi, 40)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    rays = np.concatenate([ring * radius * ratio for ratio in (0.0, 0.1, 0.5, 0.8, 1.0)])
    np.testing.assert_allclose(normalise(camera, distort(camera, rays)), rays, atol=1e-8)


@settings(deadline=None)
@given(k=st.tuples(*[st.floats(-0.02, 0.02)] * 4))
@example(k=(0.015625, 0.01953125, 0.01953125, -0.01171875))  # Newton's steps alternate
def test_any_plausible_fisheye_can_be_inverted(k: tuple[float, float, float, float]) -> None:
    camera = Camera(1000, 1000, 300.0, 300.0, 500.0, 500.0, "equidistant", k)
    angles = np.linspace(0.0, min(0.95 * angle_reach(k), np.deg2rad(85.0)), 60)
    rays = np.column_stack([np.tan(angles), np.zeros(60)])
    np.testing.assert_allclose(
        np.arctan(normalise(camera, distort(camera, rays))), np.arctan(rays), atol=1e-9
    )


def test_rays_beyond_the_fold_of_the_lens_do_not_fall_into_the_image() -> None:
    camera = CAMERAS["radtan5_strong"]
    assert radial_reach(camera.distortion) == pytest.approx(1.196, abs=0.01)
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
def test_empty_arrays_keep_their_shapes(name: str) -> None:
    nothing = np.empty((0, 2))
    assert distort(CAMERAS[name], nothing).shape == (0, 2)
    assert normalise(CAMERAS[name], nothing).shape == (0, 2)


def _published(camera: Camera, point: Floats) -> tuple[float, float]:
    """One pixel, in scalars, as the papers write it."""
    x, y, z = (float(value) for value in point)
    d = math.sqrt(x * x + y * y + z * z)
    if camera.distortion_model == "double_sphere":  # Usenko et al. 2018
        xi, alpha = camera.distortion
        below = alpha * math.hypot(x, y, xi * d + z) + (1 - alpha) * (xi * d + z)
        mx, my = x / below, y / below
    elif camera.distortion_model == "extended_unified":  # Khomutenko et al. 2016
        alpha, beta = camera.distortion
        rho = math.sqrt(beta * (x * x + y * y) + z * z)
        mx, my = x / (alpha * rho + (1 - alpha) * z), y / (alpha * rho + (1 - alpha) * z)
    else:  # Mei and Rives 2007: onto the unit sphere, from xi above its centre to a plane, lens
        xi, k1, k2, p1, p2 = camera.distortion
        px, py = (x / d) / (z / d + xi), (y / d) / (z / d + xi)
        r2 = px * px + py * py
        radial = 1 + k1 * r2 + k2 * r2 * r2
        mx = px * radial + 2 * p1 * px * py + p2 * (r2 + 2 * px * px)
        my = py * radial + p1 * (r2 + 2 * py * py) + 2 * p2 * px * py
    return camera.fx * mx + camera.cx, camera.fy * my + camera.cy


@each_wide_camera
def test_agrees_with_the_published_formulas(name: str) -> None:
    camera = CAMERAS[name]
    rays = _rays_within(camera)
    points = np.column_stack([rays, np.ones(len(rays))]) * np.linspace(0.2, 9.0, len(rays))[:, None]
    expected = [_published(camera, point) for point in points]
    np.testing.assert_allclose(project(camera, points), expected, rtol=0, atol=1e-9)


@settings(deadline=None)
@example(xi=-0.5625, alpha=0.0, angle=1.0, around=0.0)
@given(
    xi=st.floats(-0.6, 0.9),
    alpha=st.floats(0.0, 1.0),
    angle=st.floats(0.0, 1.55),
    around=st.floats(0.0, 6.3),
)
def test_any_double_sphere_is_inverted_or_outside(
    xi: float, alpha: float, angle: float, around: float
) -> None:
    camera = Camera(800, 800, 300.0, 301.0, 400.0, 399.0, "double_sphere", (xi, alpha))
    ray = np.tan(angle) * np.array([[np.cos(around), np.sin(around)]])
    # The published limit; it lies in front of the camera only where xi is far below 0.
    w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    margin = np.cos(angle) + (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
    # With an alpha of nearly 0, eq. 42's divisor ends before that limit does.
    ahead = np.cos(angle) + xi
    divisor = alpha * np.hypot(np.sin(angle), ahead) + (1 - alpha) * ahead
    pixel = distort(camera, ray)
    if margin < -1e-9 or divisor < -1e-9:
        assert np.isnan(pixel).all()
    elif margin > 1e-6 and divisor > 1e-3:  # the very edge may round to either side
        assert np.abs(distort(camera, normalise(camera, pixel)) - pixel).max() < 1e-9


@settings(deadline=None)
@given(alpha=st.floats(0.0, 1.0), beta=st.floats(0.2, 3.0), angle=st.floats(0.0, 1.55))
def test_any_extended_unified_camera_is_inverted(alpha: float, beta: float, angle: float) -> None:
    camera = Camera(800, 800, 300.0, 301.0, 400.0, 399.0, "extended_unified", (alpha, beta))
    pixel = distort(camera, np.tan(angle) * np.array([[0.6, -0.8]]))
    assert np.abs(distort(camera, normalise(camera, pixel)) - pixel).max() < 1e-9


@settings(deadline=None)
@given(
    xi=st.floats(0.0, 3.0),
    k1=st.floats(-0.3, 0.3),
    k2=st.floats(-0.1, 0.1),
    angle=st.floats(0.0, 1.5),
)
def test_any_omni_camera_is_inverted(xi: float, k1: float, k2: float, angle: float) -> None:
    lens = (k1, k2, 1e-3, -1e-3)
    camera = Camera(800, 800, 500.0, 501.0, 400.0, 399.0, "omni", (xi, *lens))
    ray = np.tan(angle) * np.array([[0.6, -0.8]])
    if np.sin(angle) / (np.cos(angle) + xi) > 0.95 * radial_reach(lens):
        return
    pixel = distort(camera, ray)
    # Far outside of the image, of a pinhole with strong distortion, single bits are more.
    np.testing.assert_allclose(
        distort(camera, normalise(camera, pixel)), pixel, rtol=1e-14, atol=1e-9
    )


@each_wide_camera
def test_pixels_behind_the_camera_have_no_ray(name: str) -> None:
    """A ring beyond 90 degrees, made with the published formulas, has no x/z."""
    camera = CAMERAS[name]
    angles = np.deg2rad([80.0, 89.0, 91.0, 95.0, 100.0])
    points = np.column_stack([np.sin(angles), np.zeros(5), np.cos(angles)])
    pixels = np.array([_published(camera, point) for point in points])
    front = np.isfinite(normalise(camera, pixels)).all(axis=1)
    assert front.tolist() == [True, True, False, False, False]
    assert np.isfinite(project(camera, points)).all(axis=1).tolist() == front.tolist()


def test_double_sphere_pixels_outside_of_the_lens_have_no_ray() -> None:
    camera = CAMERAS["double_sphere"]
    # alpha above 1/2: nothing falls farther out than r^2 = 1 / (2 alpha - 1).
    limit = camera.fx / np.sqrt(2 * 0.5931177593944744 - 1)
    assert np.isnan(normalise(camera, np.array([[254.96 + limit + 1.0, 256.9]]))).all()


def test_a_double_sphere_without_spheres_is_a_pinhole() -> None:
    plain = CAMERAS["pinhole"]
    for model, values in (("double_sphere", (0.0, 0.0)), ("extended_unified", (0.0, 1.0))):
        camera = replace(plain, distortion_model=model, distortion=values)
        rays = _rays_within(plain)
        np.testing.assert_allclose(distort(camera, rays), distort(plain, rays), atol=1e-9)
        np.testing.assert_allclose(normalise(camera, distort(plain, rays)), rays, atol=1e-12)


@each_camera
def test_points_behind_the_camera_are_outside(name: str) -> None:
    points = np.array([[0.1, 0.2, -1.0], [0.1, 0.2, 0.0], [0.1, 0.2, 1.0]])
    seen = np.isfinite(project(CAMERAS[name], points)).all(axis=1)
    assert seen.tolist() == [False, False, True]


@each_camera
def test_the_scale_on_the_axis(name: str) -> None:
    camera = CAMERAS[name]
    step = distort(camera, np.array([[1e-6, 0.0]])) - distort(camera, np.zeros((1, 2)))
    assert step[0, 0] / 1e-6 == pytest.approx(centre_scale(camera) * camera.fx, rel=1e-5)


def test_equidistant_without_coefficients_is_not_a_pinhole() -> None:
    camera = Camera(100, 100, 50.0, 50.0, 50.0, 50.0, "equidistant", (0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(
        distort(camera, np.array([[1.0, 0.0]])), [[50.0 + 50.0 * np.pi / 4, 50.0]], atol=1e-12
    )


@pytest.mark.parametrize("ratio", [0.3, 0.5, 0.7, 0.9])
def test_lenses_that_fold_are_inverted_up_to_the_fold(ratio: float) -> None:
    """First guesses lie at the fold, or beyond, where Newton's method alone goes astray."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        lens = (rng.uniform(0.0, 0.3), rng.uniform(-0.1, -0.01), *rng.uniform(-1e-3, 1e-3, 2))
        radius = ratio * radial_reach(lens)
        bearing = rng.uniform(0.0, 2.0 * np.pi, 20)
        rays = radius * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        camera = Camera(800, 800, 500.0, 501.0, 400.0, 399.0, "radtan", lens)
        assert np.abs(normalise(camera, distort(camera, rays)) - rays).max() < 1e-8
