from __future__ import annotations

import numpy as np

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import se3_exp, transform_points
from vo.engine.geometry.epipolar import epipolar_segments

INTRINSICS = Intrinsics(500.0, 480.0, 320.0, 200.0)
MOTION = se3_exp(np.array([0.02, -0.1, 0.01, 0.3, -0.1, -2.0]))  # 2 m ahead
XY = np.random.default_rng(0).uniform((0, 0), (640, 400), (50, 2))


def _rays(xy: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = INTRINSICS
    return np.column_stack([(xy - (cx, cy)) / (fx, fy), np.ones(len(xy))])


def _second(xy: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and depths in the second view of pixels of the first."""
    fx, fy, cx, cy = INTRINSICS
    moved = transform_points(MOTION, _rays(xy) * depth[:, None])
    return moved[:, :2] / moved[:, 2:] * (fx, fy) + (cx, cy), moved[:, 2]


def test_a_segment_begins_at_the_nearest_and_ends_at_the_farthest_depth() -> None:
    start, end, possible = epipolar_segments(XY, MOTION, 2.5, 40.0, 0.01, INTRINSICS)
    assert possible.all()
    assert np.allclose(start, _second(XY, np.full(len(XY), 2.5))[0], atol=1e-9)
    assert np.allclose(end, _second(XY, np.full(len(XY), 40.0))[0], atol=1e-9)


def test_points_that_lose_too_much_depth_are_cut_off() -> None:
    start, _, possible = epipolar_segments(XY, MOTION, 2.5, 40.0, 0.75, INTRINSICS)
    assert possible.all()
    at_zero, at_one = (_second(XY, np.full(len(XY), depth))[1] for depth in (1e-9, 1.0))
    slope = at_one - at_zero  # of depth in the second view over depth in the first
    depth = -at_zero / (slope - 0.75)
    assert np.all(depth > 2.5)
    assert np.allclose(_second(XY, depth)[1], 0.75 * depth)
    assert np.allclose(start, _second(XY, depth)[0], atol=1e-6)


def test_no_segment_if_the_nearest_point_is_behind_the_second_camera() -> None:
    ahead = MOTION.copy()
    ahead[2, 3] = -2.2
    nearest = np.full(len(XY), 2.0)
    start, end, possible = epipolar_segments(XY, ahead, 2.0, 40.0, 0.95, INTRINSICS)
    depth_there = nearest * (ahead[2, :3] @ _rays(XY).T) + ahead[2, 3]
    assert np.array_equal(possible, (depth_there > 0.004) | _is_moved_on(XY, ahead, 0.95))
    assert 0 < possible.sum() < len(XY)
    assert np.array_equal(np.isnan(start[:, 0]), ~possible)
    assert np.array_equal(np.isnan(end[:, 0]), ~possible)


def _is_moved_on(xy: np.ndarray, motion: np.ndarray, min_ratio: float) -> np.ndarray:
    return np.asarray(_rays(xy) @ motion[2, :3] - min_ratio > 0.05)
