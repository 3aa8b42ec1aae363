"""Directions at any angle from the axis of wide lenses, and their fields of view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vo.base.geometry.cameras import directions, distort, equirectangular, normalise, project_wide
from vo.base.geometry.lens_field import half_angles
from vo.base.geometry.rectification_maps import wide_maps
from vo.base.types import Camera, Floats

LENSES = {
    "equidistant": (Camera(480, 480, 144.7, 145.0, 240, 239, "equidistant", (-0.01, 0, 0, 0)), 110),
    "double_sphere": (
        Camera(512, 512, 158.3, 158.2, 255, 257, "double_sphere", (-0.17, 0.59)),
        100,
    ),
    "extended_unified": (Camera(512, 512, 190, 190, 255, 257, "extended_unified", (0.7, 1.1)), 100),
    "omni": (Camera(800, 600, 420, 421, 400, 300, "omni", (1.4, -0.1, 0.01, 0.001, 0.0005)), 100),
    "equirectangular": (equirectangular(1024, 512), 180),
}
each_lens = pytest.mark.parametrize("name", LENSES)


def _rays(most_deg: float) -> Floats:
    rng = np.random.default_rng(3)
    angle, around = np.deg2rad(rng.uniform(0, most_deg, 2000)), rng.uniform(0, 2 * np.pi, 2000)
    across = np.sin(angle)
    return np.column_stack([across * np.cos(around), across * np.sin(around), np.cos(angle)])


@each_lens
def test_directions_invert_the_projection_behind_the_camera_too(name: str) -> None:
    camera, most_deg = LENSES[name]
    rays = _rays(most_deg)
    assert (rays[:, 2] < -0.1).sum() > 50
    np.testing.assert_allclose(directions(camera, project_wide(camera, rays)), rays, atol=1e-9)


@each_lens
def test_in_front_of_the_camera_it_is_the_same_lens(name: str) -> None:
    camera = LENSES[name][0]
    rays = _rays(80.0)
    flat = rays[:, :2] / rays[:, 2:]
    np.testing.assert_allclose(distort(camera, flat), project_wide(camera, rays), atol=1e-9)
    np.testing.assert_allclose(normalise(camera, project_wide(camera, rays)), flat, rtol=1e-7)


def test_equirectangular_pixels_are_longitude_and_latitude() -> None:
    camera = equirectangular(360, 180)
    rays = np.array([[0, 0, 1.0], [1, 0, 0], [-1, 0, 1], [0, 1, 1], [0, -1, 0]])
    expected = [[180, 90], [270, 90], [135, 90], [180, 135], [180, 0]]
    np.testing.assert_allclose(project_wide(camera, rays) + 0.5, expected, atol=1e-9)


def test_a_lens_has_no_pixels_beyond_its_reach() -> None:
    behind = np.array([[0.01, 0.0, -1.0]])
    for name in ("double_sphere", "extended_unified", "omni"):
        assert np.isnan(project_wide(LENSES[name][0], behind)).all()
    folded = replace(LENSES["equidistant"][0], distortion=(-0.1, 0.0, 0.0, 0.0))  # up to 105°
    assert np.isnan(project_wide(folded, behind)).all()
    assert np.isfinite(project_wide(folded, _rays(100.0))).all()
    assert np.isnan(project_wide(Camera(640, 480, 300, 300, 320, 240), behind)).all()


@pytest.mark.parametrize(
    ("camera", "across_deg", "along_deg"),
    [
        (Camera(640, 480, 320.0, 320.0, 319.5, 239.5), 45.0, 36.9),
        (LENSES["equidistant"][0], 95.0, 95.0),
        (Camera(480, 300, 144.7, 144.7, 240, 150, "equidistant", (0.0,) * 4), 95.0, 59.4),
        (equirectangular(1024, 512), 180.0, 90.0),
    ],
)
def test_half_angles_are_those_of_the_edges(
    camera: Camera, across_deg: float, along_deg: float
) -> None:
    found = np.rad2deg(half_angles(camera))
    assert np.all(found <= np.array([across_deg, along_deg]) + 4.0)
    assert np.all(found >= np.array([across_deg, along_deg]) - 2.5)


def test_maps_of_a_lens_end_at_the_angle_of_its_edges() -> None:
    camera = replace(LENSES["equidistant"][0], distortion=(0.0,) * 4)  # 95° at the edges
    looking_right = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])  # view_from_cam
    pinhole = np.array([[100.0, 0, 100], [0, 100.0, 0], [0, 0, 1]])
    seen = wide_maps(camera, looking_right, pinhole, (201, 1))[0][0, :, 0] >= 0
    last = int(np.flatnonzero(seen)[-1])
    assert seen[:last].all() and 92.0 < 90.0 + np.rad2deg(np.arctan((last - 100) / 100.0)) < 95.5
