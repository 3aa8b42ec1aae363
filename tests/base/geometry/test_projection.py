from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.projection import (
    Intrinsics,
    by_cam_from_world,
    by_world_axis,
    by_world_from_cam,
    from_world,
    pixel,
    point_derivatives,
    project,
    to_camera,
)
from vo.base.geometry.quantiles import median, percentiles
from vo.base.geometry.transforms import inverse, se3_exp, transform_points
from vo.base.types import Floats

INTRINSICS = Intrinsics(500.0, 510.0, 320.0, 200.0)
FOCAL_BASELINE = 60.0
WORLD_FROM_CAM = se3_exp(np.array([0.3, -0.5, 0.2, 1.0, -2.0, 0.5]))
POINT = transform_points(WORLD_FROM_CAM, np.array([[0.7, -0.4, 4.0]]))[0]
STEP = 1e-6


def _uvd(world_from_cam: Floats, point: Floats) -> Floats:
    """Pixel and disparity of a point of the world."""
    x, y, z = transform_points(inverse(world_from_cam), point[None])[0]
    fx, fy, cx, cy = INTRINSICS
    return np.array([fx * x / z + cx, fy * y / z + cy, FOCAL_BASELINE / z])


def _in_camera() -> tuple[float, float, float]:
    x, y, z = transform_points(inverse(WORLD_FROM_CAM), POINT[None])[0].tolist()
    return x, y, z


def _derivatives(*, normalised: bool) -> tuple[float, ...]:
    x, y, z = _in_camera()
    scale = 1.0 if normalised else 1.0 / z
    if normalised:
        x, y = x / z, y / z
    fx, fy = INTRINSICS.fx, INTRINSICS.fy
    found: tuple[float, ...] = point_derivatives(fx, fy, FOCAL_BASELINE, x, y, scale, 1.0 / z)
    return found


def test_the_intrinsics_of_a_matrix() -> None:
    matrix = np.array([[500.0, 0.0, 320.0], [0.0, 510.0, 200.0], [0.0, 0.0, 1.0]])
    assert Intrinsics.from_matrix(matrix) == INTRINSICS


def test_a_pose_and_its_inverse_lead_to_the_same_camera_coordinates() -> None:
    expected = pytest.approx(_in_camera(), abs=1e-12)
    assert to_camera(inverse(WORLD_FROM_CAM), *POINT.tolist()) == expected
    assert from_world(WORLD_FROM_CAM, *POINT.tolist()) == expected


def test_the_pixel_of_a_point_in_all_forms() -> None:
    x, y, z = _in_camera()
    expected = pytest.approx(_uvd(WORLD_FROM_CAM, POINT)[:2], abs=1e-9)
    assert project(INTRINSICS, x, y, z) == expected
    assert pixel(INTRINSICS, x, y, 1.0 / z) == expected
    assert pixel(INTRINSICS, x / z, y / z, 1.0) == expected


@pytest.mark.parametrize("normalised", [False, True])
def test_derivatives_by_the_axes_of_the_world(normalised: bool) -> None:
    derivatives = _derivatives(normalised=normalised)
    for axis, step in enumerate(STEP * np.eye(3)):
        ahead, behind = (_uvd(WORLD_FROM_CAM, POINT + sign * step) for sign in (1.0, -1.0))
        found = by_world_axis(derivatives, *WORLD_FROM_CAM[axis, :3].tolist())
        assert found == pytest.approx((ahead - behind) / (2.0 * STEP), abs=1e-5)


def test_derivatives_by_the_pose_of_the_camera() -> None:
    rows = np.array(by_world_from_cam(_derivatives(normalised=False), *_in_camera()))
    for k, step in enumerate(STEP * np.eye(6)):
        ahead, behind = (_uvd(WORLD_FROM_CAM @ se3_exp(s * step), POINT) for s in (1.0, -1.0))
        assert rows[:, k] == pytest.approx((ahead - behind) / (2.0 * STEP), abs=1e-5)


def test_derivatives_by_the_inverse_pose() -> None:
    x, y, z = _in_camera()
    rows = np.array(by_cam_from_world(INTRINSICS.fx, INTRINSICS.fy, x / z, y / z, 1.0 / z))
    for k, step in enumerate(STEP * np.eye(6)):
        ahead, behind = (
            _uvd(inverse(se3_exp(s * step) @ inverse(WORLD_FROM_CAM)), POINT) for s in (1.0, -1.0)
        )
        expected = (ahead - behind)[:2] / (2.0 * STEP)
        assert rows[:, k] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("shape", [1, 2, 7, 100, (3, 4)])
def test_quantiles_equal_those_of_numpy(shape: int | tuple[int, ...]) -> None:
    values = np.random.default_rng(0).normal(size=shape)
    assert median(values) == np.median(values)
    np.testing.assert_allclose(
        percentiles(values, (0, 5, 50, 95, 100)),
        np.percentile(values, (0, 5, 50, 95, 100)),
        rtol=1e-14,
    )


def test_quantiles_of_lists_and_integers() -> None:
    assert median([3, 1, 2, 10]) == 2.5
    assert median(np.array([200, 250], np.uint8)) == 225.0
    assert percentiles(np.array([[0, 200], [100, 0]], np.uint8), (50,)) == [50.0]
