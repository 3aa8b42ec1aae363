from __future__ import annotations

import numpy as np

from vo.geometry.epipolar_segments import epipolar_segments
from vo.geometry.transforms import se3_exp, transform_points

INTRINSICS = 500.0, 480.0, 320.0, 200.0
MOTION = se3_exp(np.array([0.02, -0.1, 0.01, 0.3, -0.1, -2.0]))  # 2 m ahead
XY = np.random.default_rng(0).uniform((0, 0), (640, 400), (50, 2))


def _second(xy: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and depths in the second view of pixels of the first."""
    fx, fy, cx, cy = INTRINSICS
    rays = np.column_stack([(xy - (cx, cy)) / (fx, fy), np.ones(len(xy))])
    moved = transform_points(MOTION, rays * depth[:, None])
    return moved[:, :2] / moved[:, 2:] * (fx, fy) + (cx, cy), moved[:, 2]


def test_a_segment_goes_from_the_nearest_to_the_farthest_depth() -> None:
    nearest = np.linspace(2.5, 5.0, len(XY))
    start, end, possible = epipolar_segments(XY, MOTION, nearest, 40.0, INTRINSICS)
    assert possible.all()
    assert np.allclose(start, _second(XY, nearest)[0], atol=1e-9)
    assert np.allclose(end, _second(XY, np.full(len(XY), 40.0))[0], atol=1e-9)


def test_pixels_whose_nearest_point_is_behind_the_second_camera_have_none() -> None:
    nearest = np.linspace(1.0, 3.0, len(XY))
    start, end, possible = epipolar_segments(XY, MOTION, nearest, 40.0, INTRINSICS)
    assert np.array_equal(possible, _second(XY, nearest)[1] > 0.004)
    assert 0 < possible.sum() < len(XY)
    assert np.array_equal(np.isnan(start[:, 0]), ~possible)
    assert np.array_equal(np.isnan(end[:, 0]), ~possible)
