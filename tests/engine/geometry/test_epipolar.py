from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import make_transform, rotation_angle, se3_exp, transform_points
from vo.base.types import Floats
from vo.engine.geometry import epipolar
from vo.engine.geometry.epipolar import epipolar_segments

MATRIX = np.array([[700.0, 0.0, 320.0], [0.0, 690.0, 240.0], [0.0, 0.0, 1.0]])
MOTION = se3_exp(np.array([0.03, -0.08, 0.02, -0.9, 0.15, 0.4]))
PLANE_NORMAL, PLANE_DISTANCE = np.array([0.2, -0.3, 1.0]) / np.sqrt(1.13), 6.0


def _project(points: Floats) -> Floats:
    pixels = points @ MATRIX.T
    return np.asarray(pixels[:, :2] / pixels[:, 2:])


def _general(count: int, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(3.0, 15.0, (count, 1))
    return np.hstack([rng.uniform((-0.42, -0.32), (0.42, 0.32), (count, 2)) * depth, depth])


def _on_plane(count: int) -> Floats:
    rays = _general(count)
    return np.asarray(rays * (PLANE_DISTANCE / (rays @ PLANE_NORMAL))[:, None])


def _views(points: Floats, noise: float = 0.0, outliers: float = 0.0) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(1)
    first, second = _project(points), _project(transform_points(MOTION, points))
    first = first + noise * rng.standard_normal(first.shape)
    second = second + noise * rng.standard_normal(second.shape)
    wrong = int(outliers * len(points))
    second[:wrong] = rng.uniform((0, 0), (640, 480), (wrong, 2))
    return first, second


def _direction_error_deg(found: Floats, truth: Floats) -> float:
    a, b = found[:3, 3], truth[:3, 3] / np.linalg.norm(truth[:3, 3])
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _rotation_error_deg(found: Floats) -> float:
    return float(np.rad2deg(rotation_angle(found[:3, :3].T @ MOTION[:3, :3])))


def _motion(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    found = epipolar.find_essential(first, second, MATRIX, 1.0)
    assert found is not None
    essential, inlier = found
    return epipolar.recover_motion(essential, first, second, MATRIX, inlier), inlier


def test_the_motion_is_exact_without_noise() -> None:
    motion, inlier = _motion(*_views(_general(100)))
    assert _rotation_error_deg(motion) < 1e-4
    assert _direction_error_deg(motion, MOTION) < 1e-3
    assert np.linalg.norm(motion[:3, 3]) == pytest.approx(1.0)
    assert inlier.all()


def test_the_motion_is_found_to_a_tenth_of_a_degree_with_noise_and_outliers() -> None:
    motion, inlier = _motion(*_views(_general(400), noise=0.25, outliers=0.25))
    assert _rotation_error_deg(motion) < 0.1
    assert _direction_error_deg(motion, MOTION) < 0.5
    assert inlier[100:].mean() > 0.9
    assert inlier[:100].mean() < 0.1


def test_arrays_need_not_be_contiguous() -> None:
    first, second = _views(_general(100))
    wide = np.hstack([first, second])
    matrix = np.asfortranarray(MATRIX)
    found = epipolar.find_essential(wide[:, :2], wide[:, 2:], matrix, 1.0)
    assert found is not None
    motion = epipolar.recover_motion(found[0], wide[:, :2], wide[:, 2:], matrix, found[1])
    assert _rotation_error_deg(motion) < 1e-4


@pytest.mark.parametrize("count", [0, 4, 5, 7])
def test_too_few_points_give_none(count: int) -> None:
    first, second = _views(_general(count))
    assert epipolar.find_essential(first, second, MATRIX, 1.0) is None
    assert epipolar.find_homography(first, second, 1.0) is None


def test_points_without_motion_or_spread_never_raise() -> None:
    still = _project(_general(60))
    spot = np.tile([[100.0, 100.0]], (60, 1))
    line = np.column_stack([np.linspace(0, 600, 60), np.full(60, 240.0)])
    for first, second in ((still, still), (spot, spot), (line, line + (3, 0)), (spot, still)):
        found = epipolar.find_essential(first, second, MATRIX, 1.0)
        assert found is None or found[0].shape == (3, 3)
        plane = epipolar.find_homography(first, second, 1.0)
        assert plane is None or plane[0].shape == (3, 3)


def test_a_plane_is_found_as_a_homography_with_its_motion() -> None:
    first, second = _views(_on_plane(200), noise=0.2, outliers=0.2)
    found = epipolar.find_homography(first, second, 1.0)
    assert found is not None
    homography, inlier = found
    assert inlier[40:].mean() > 0.9
    motions = epipolar.motions_of_homography(homography, MATRIX)
    assert 1 <= len(motions) <= 4
    for motion in motions:
        assert np.linalg.norm(motion[:3, 3]) == pytest.approx(1.0)
    best = min(motions, key=_rotation_error_deg)
    assert _rotation_error_deg(best) < 0.5
    assert _direction_error_deg(best, MOTION) < 3.0


def test_a_homography_of_pure_rotation_allows_no_translation() -> None:
    rotation = se3_exp(np.array([0.1, 0.05, 0.0, 0.0, 0.0, 0.0]))[:3, :3]
    homography = MATRIX @ rotation @ np.linalg.inv(MATRIX)
    assert epipolar.motions_of_homography(homography / homography[2, 2], MATRIX) == []


def test_epipolar_errors_are_squared_distances_to_the_lines() -> None:
    sideways = make_transform(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    fundamental = epipolar.fundamental_from_motion(sideways, np.diag([500.0, 500.0, 1.0]))
    first = np.array([[10.0, 20.0], [30.0, 40.0]])
    second = first + [[7.0, 0.0], [-5.0, 3.0]]
    in_second, in_first = epipolar.epipolar_errors(fundamental, first, second)
    np.testing.assert_allclose(in_second, [0.0, 9.0], atol=1e-9)
    np.testing.assert_allclose(in_first, [0.0, 9.0], atol=1e-9)


def test_errors_of_the_true_motion_and_plane_are_zero() -> None:
    first, second = _views(_on_plane(50))
    fundamental = epipolar.fundamental_from_motion(MOTION, MATRIX)
    inverse = np.linalg.inv(MATRIX)
    plane = MOTION[:3, :3] + np.outer(MOTION[:3, 3], PLANE_NORMAL) / PLANE_DISTANCE
    for errors in (
        epipolar.epipolar_errors(fundamental, first, second),
        epipolar.transfer_errors(MATRIX @ plane @ inverse, first, second),
    ):
        np.testing.assert_allclose(errors, 0.0, atol=1e-12)


def test_transfer_errors_are_squared_distances_in_each_view() -> None:
    double = np.diag([2.0, 2.0, 1.0])
    first, second = np.array([[10.0, 10.0]]), np.array([[24.0, 20.0]])
    in_second, in_first = epipolar.transfer_errors(double, first, second)
    assert in_second.tolist() == [16.0]
    assert in_first.tolist() == [4.0]


@pytest.mark.parametrize("length", [0.003, 0.03, 0.3])
def test_the_sign_of_the_motion_is_right_however_short_it_is(length: float) -> None:
    points = _general(200)
    short = make_transform(MOTION[:3, :3], length * MOTION[:3, 3])
    first, second = _project(points), _project(transform_points(short, points))
    motion, _ = _motion(first, second)
    assert _rotation_error_deg(motion) < 0.01
    assert _direction_error_deg(motion, MOTION) < 1.0


SEGMENT_INTRINSICS = Intrinsics(500.0, 480.0, 320.0, 200.0)
AHEAD = se3_exp(np.array([0.02, -0.1, 0.01, 0.3, -0.1, -2.0]))  # 2 m ahead
SEGMENT_XY = np.random.default_rng(0).uniform((0, 0), (640, 400), (50, 2))


def _rays(xy: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = SEGMENT_INTRINSICS
    return np.column_stack([(xy - (cx, cy)) / (fx, fy), np.ones(len(xy))])


def _second(xy: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and depths in the second view of pixels of the first."""
    fx, fy, cx, cy = SEGMENT_INTRINSICS
    moved = transform_points(AHEAD, _rays(xy) * depth[:, None])
    return moved[:, :2] / moved[:, 2:] * (fx, fy) + (cx, cy), moved[:, 2]


def test_a_segment_begins_at_the_nearest_and_ends_at_the_farthest_depth() -> None:
    start, end, possible = epipolar_segments(SEGMENT_XY, AHEAD, 2.5, 40.0, 0.01, SEGMENT_INTRINSICS)
    assert possible.all()
    assert np.allclose(start, _second(SEGMENT_XY, np.full(len(SEGMENT_XY), 2.5))[0], atol=1e-9)
    assert np.allclose(end, _second(SEGMENT_XY, np.full(len(SEGMENT_XY), 40.0))[0], atol=1e-9)


def test_points_that_lose_too_much_depth_are_cut_off() -> None:
    start, _, possible = epipolar_segments(SEGMENT_XY, AHEAD, 2.5, 40.0, 0.75, SEGMENT_INTRINSICS)
    assert possible.all()
    at_zero, at_one = (
        _second(SEGMENT_XY, np.full(len(SEGMENT_XY), depth))[1] for depth in (1e-9, 1.0)
    )
    slope = at_one - at_zero  # of depth in the second view over depth in the first
    depth = -at_zero / (slope - 0.75)
    assert np.all(depth > 2.5)
    assert np.allclose(_second(SEGMENT_XY, depth)[1], 0.75 * depth)
    assert np.allclose(start, _second(SEGMENT_XY, depth)[0], atol=1e-6)


def test_no_segment_if_the_nearest_point_is_behind_the_second_camera() -> None:
    ahead = AHEAD.copy()
    ahead[2, 3] = -2.2
    nearest = np.full(len(SEGMENT_XY), 2.0)
    start, end, possible = epipolar_segments(SEGMENT_XY, ahead, 2.0, 40.0, 0.95, SEGMENT_INTRINSICS)
    depth_there = nearest * (ahead[2, :3] @ _rays(SEGMENT_XY).T) + ahead[2, 3]
    assert np.array_equal(possible, (depth_there > 0.004) | _is_moved_on(SEGMENT_XY, ahead, 0.95))
    assert 0 < possible.sum() < len(SEGMENT_XY)
    assert np.array_equal(np.isnan(start[:, 0]), ~possible)
    assert np.array_equal(np.isnan(end[:, 0]), ~possible)


def _is_moved_on(xy: np.ndarray, motion: np.ndarray, min_ratio: float) -> np.ndarray:
    return np.asarray(_rays(xy) @ motion[2, :3] - min_ratio > 0.05)
