from __future__ import annotations

import numpy as np
import pytest

from data_synth.motion.spline import PosePath
from vo.base.types import Floats

EPSILON_S = 1e-5


def _path(turns: int | None) -> PosePath:
    controls = np.random.default_rng(5).normal(0.0, 0.4, (40, 6))
    if turns is not None:
        controls[:, 3] += 2.0 * np.pi * turns * np.arange(40) / 40
    return PosePath(controls, 0.25, 4, 8.0 if turns is None else 10.0, turns)


def _body_rates(path: PosePath, times_s: Floats) -> Floats:
    before, after = (path.world_from_body(times_s + e)[:, :3, :3] for e in (-EPSILON_S, EPSILON_S))
    change = np.swapaxes(before, 1, 2) @ after
    skew = (change - np.swapaxes(change, 1, 2)) / (4.0 * EPSILON_S)
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)


@pytest.mark.parametrize("turns", [None, 2])
def test_derivatives_are_those_of_the_poses(turns: int | None) -> None:
    path = _path(turns)
    times = np.linspace(-0.2, path.duration_s + 0.2, 997)
    before, after = times - EPSILON_S, times + EPSILON_S
    moved = path.world_from_body(after)[:, :3, 3] - path.world_from_body(before)[:, :3, 3]
    np.testing.assert_allclose(path.velocity(times), moved / (2 * EPSILON_S), atol=1e-8)
    gained = path.velocity(after) - path.velocity(before)
    np.testing.assert_allclose(path.acceleration(times), gained / (2 * EPSILON_S), atol=3e-3)
    np.testing.assert_allclose(path.angular_velocity(times), _body_rates(path, times), atol=1e-7)


def test_acceleration_is_continuous_at_the_knots() -> None:
    path = _path(None)
    knots = np.arange(1, 30) * path.step_s
    before, after = path.acceleration(knots - 1e-9), path.acceleration(knots + 1e-9)
    np.testing.assert_allclose(before, after, atol=1e-5)


def test_closed_path_is_periodic() -> None:
    path = _path(2)
    times = np.linspace(0.0, path.duration_s, 101)
    for many in (-1.0, 1.0, 3.0):
        later = times + many * path.duration_s
        np.testing.assert_allclose(
            path.world_from_body(later), path.world_from_body(times), atol=1e-9
        )
        np.testing.assert_allclose(
            path.angular_velocity(later), path.angular_velocity(times), atol=1e-8
        )


def test_positive_pitch_lifts_the_nose_and_positive_roll_lowers_the_right_side() -> None:
    controls = np.tile([0.0, 0.0, 0.0, 0.3, 0.2, 0.1], (8, 1))
    rotation = PosePath(controls, 1.0, 2, 3.0).world_from_body(np.array([1.0]))[0, :3, :3]
    ahead, left, up = rotation.T
    assert ahead[2] == pytest.approx(np.sin(0.2))
    assert left[2] == pytest.approx(np.sin(0.1) * np.cos(0.2))
    np.testing.assert_allclose(np.cross(ahead, left), up, atol=1e-12)


def test_open_path_refuses_times_outside() -> None:
    with pytest.raises(ValueError, match="are outside the spline"):
        _path(None).velocity(np.array([0.0, 9.0]))
