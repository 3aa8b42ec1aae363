"""Scale of a step, prediction of the next pose, choice of keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from vo.config import KeyframeConfig
from vo.geometry.transforms import inverse, se3_exp, transform_points
from vo.tracking.keyframe_policy import Change, median_parallax, needs_keyframe
from vo.tracking.motion_model import ConstantVelocity
from vo.tracking.scale import scale_from_points
from vo.types import Floats

# Scale


def _step(length: float) -> tuple[Floats, Floats, Floats]:
    """A motion of unit length, points before it and their rays after a step of `length`."""
    rng = np.random.default_rng(0)
    unit = se3_exp(np.array([0.02, -0.03, 0.01, 0.0, 0.0, 0.0]))
    unit[:3, 3] = np.array([0.6, -0.1, -0.79]) / np.linalg.norm([0.6, -0.1, -0.79])
    points = rng.uniform((-4, -3, 4), (4, 3, 20), (80, 3))
    motion = unit.copy()
    motion[:3, 3] *= length
    moved = transform_points(motion, points)
    return unit, points, moved[:, :2] / moved[:, 2:]


@pytest.mark.parametrize("length", [0.01, 0.3, 2.5])
def test_the_scale_is_exact_without_noise(length: float) -> None:
    scale, support = scale_from_points(*_step(length))
    assert scale == pytest.approx(length, rel=1e-9)
    assert support == 80


def test_the_scale_survives_outliers_and_noise() -> None:
    unit, points, rays = _step(0.5)
    rng = np.random.default_rng(1)
    rays = rays + rng.normal(0, 0.0005, rays.shape)
    rays[:20] += rng.uniform(-0.3, 0.3, (20, 2))
    scale, support = scale_from_points(unit, points, rays)
    assert scale == pytest.approx(0.5, rel=0.05)
    assert 50 <= support <= 70


def test_points_that_move_the_other_way_support_no_scale() -> None:
    scale, support = scale_from_points(*_step(-0.5))
    assert scale <= 0
    assert support == 0


def test_no_points_support_no_scale() -> None:
    unit, points, rays = _step(0.5)
    assert scale_from_points(unit, points[:0], rays[:0]) == (0.0, 0)


def test_points_in_the_direction_of_motion_say_nothing_of_the_scale() -> None:
    unit = np.eye(4)
    unit[2, 3] = -1.0
    points = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 9.0]])
    assert scale_from_points(unit, points, np.zeros((2, 2))) == (0.0, 0)


# Motion

TWIST = np.array([0.2, -0.1, 0.3, 1.0, 0.2, -0.5])  # per second


def _pose(time_s: float) -> Floats:
    return np.asarray(se3_exp(np.array([0.5, 0.1, 0, 3, 2, 1])) @ se3_exp(TWIST * time_s))


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)


@pytest.mark.parametrize("step_s", [0.05, 0.1, 0.35, 0.0])
def test_a_constant_twist_is_predicted_whatever_the_time_between_frames(step_s: float) -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.0), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    np.testing.assert_allclose(motion.predict(_ns(0.1 + step_s)), _pose(0.1 + step_s), atol=1e-9)
    np.testing.assert_array_equal(motion.last, _pose(0.1))


def test_after_a_restart_the_camera_is_expected_to_stay() -> None:
    motion = ConstantVelocity()
    np.testing.assert_array_equal(motion.predict(_ns(5.0)), np.eye(4))
    motion.restart(_ns(0.0), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    motion.restart(_ns(0.2), _pose(1.0))
    np.testing.assert_array_equal(motion.predict(_ns(0.3)), _pose(1.0))


def test_a_correction_moves_the_prediction_along() -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.0), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    moved = se3_exp(np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.0]))
    motion.carry(moved)
    expected = moved @ _pose(0.1) @ se3_exp(TWIST * 0.1)
    np.testing.assert_allclose(motion.predict(_ns(0.2)), expected, atol=1e-9)


def test_rounding_does_not_add_up_over_many_corrections() -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.0), _pose(0.0))
    for step in range(1, 200):
        motion.update(_ns(0.1 * step), motion.predict(_ns(0.1 * step)))
        target = se3_exp(np.array([0.3, 0.2, 0.01 * step, 0.1, 0.0, 0.1]))
        motion.carry(target @ inverse(motion.last))
    rotation = motion.last[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_two_poses_at_one_time_give_no_velocity() -> None:
    motion = ConstantVelocity()
    motion.restart(_ns(0.1), _pose(0.0))
    motion.update(_ns(0.1), _pose(0.1))
    np.testing.assert_array_equal(motion.predict(_ns(0.2)), _pose(0.1))


# Keyframes

CONFIG = KeyframeConfig(
    min_tracked_share=0.75, min_tracked=200, min_parallax_deg=1.5, max_gap_s=1.0
)


@pytest.mark.parametrize(
    ("tracked", "parallax_deg", "elapsed_s", "needed"),
    [
        (900, 0.5, 0.5, False),
        (740, 0.0, 0.0, True),
        (760, 0.0, 0.0, False),
        (900, 1.6, 0.1, True),
        (900, 1.4, 0.1, False),
        (900, 0.5, 1.0, True),
        (900, 0.0, 60.0, False),
    ],
)
def test_keyframes_come_with_lost_landmarks_parallax_or_time_in_motion(
    tracked: int, parallax_deg: float, elapsed_s: float, needed: bool
) -> None:
    parallax = np.deg2rad(parallax_deg)
    assert needs_keyframe(Change(tracked, 1000, parallax, elapsed_s), CONFIG) == needed


@pytest.mark.parametrize(("parallax_deg", "needed"), [(0.0, False), (0.2, False), (0.5, True)])
def test_few_landmarks_ask_for_a_keyframe_once_the_camera_has_moved(
    parallax_deg: float, needed: bool
) -> None:
    assert needs_keyframe(Change(150, 160, np.deg2rad(parallax_deg), 0.1), CONFIG) == needed


@pytest.mark.parametrize(("parallax_deg", "needed"), [(1.6, False), (2.4, False), (2.6, True)])
def test_a_single_camera_waits_for_more_parallax(parallax_deg: float, needed: bool) -> None:
    mono = KeyframeConfig(min_parallax_deg=1.5, min_parallax_mono_deg=2.5).in_mono()
    assert needs_keyframe(Change(900, 1000, np.deg2rad(parallax_deg), 0.1), mono) == needed


def test_parallax_is_the_median_angle_at_the_points() -> None:
    points = np.array([[0.5, 0.0, np.sqrt(0.75)], [0.5, 0.0, 0.5], [0.5, 0.0, 1e6]])
    found = median_parallax(points, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    assert np.rad2deg(found) == pytest.approx(60.0)


def test_parallax_is_none_without_points_or_without_motion() -> None:
    points = np.random.default_rng(0).uniform(1, 5, (20, 3))
    centre = np.array([0.1, 0.2, 0.3])
    assert median_parallax(points[:0], centre, centre + 1.0) == 0.0
    assert median_parallax(points, centre, centre) == pytest.approx(0.0, abs=1e-6)


def test_a_point_at_the_camera_centre_does_no_harm() -> None:
    points = np.zeros((1, 3))
    assert np.isfinite(median_parallax(points, np.zeros(3), np.ones(3)))
