"""Scale, gravity, velocities and biases from visual poses and inertial samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inertial_flight import (
    ACCEL_BIAS,
    GYRO_BIAS,
    Samples,
    keyframe_stamps,
    keyframes,
    path,
    sensor,
    world_from_cam,
)

from vo.base.types import Floats
from vo.engine.inertial.estimation import Estimate
from vo.engine.inertial.initialisation import (
    Keyframes,
    NotYet,
    initial_estimate,
    tilt_sigma,
    upright,
)
from vo.engine.inertial.states import LOG_SCALE


def _found(given: Keyframes) -> Estimate:
    found = initial_estimate(given)
    assert not isinstance(found, NotYet), found
    return found


def _tilt_deg(estimate: Estimate, count: int) -> Floats:
    rotation, *_ = path(1e-9 * (keyframe_stamps(count) - 10**15))
    turned = rotation @ np.swapaxes(estimate.states.rotation, 1, 2)
    return np.degrees(np.arccos(np.clip(turned[:, 2, 2], -1.0, 1.0)))


def test_exact_measurements_give_exact_states() -> None:
    found = _found(keyframes(sensor()))
    states = found.states
    np.testing.assert_allclose(np.exp(states.log_scale), 0.5, rtol=1e-3)
    np.testing.assert_allclose(states.gyro_bias[-1], GYRO_BIAS, atol=2e-5)
    np.testing.assert_allclose(states.accel_bias[-1], ACCEL_BIAS, atol=3e-3)
    assert _tilt_deg(found, 16).max() < 0.01
    _, _, velocity, _, _ = path(1e-9 * (keyframe_stamps(16) - 10**15))
    np.testing.assert_allclose(
        np.linalg.norm(states.velocity, axis=1), np.linalg.norm(velocity, axis=1), atol=1e-3
    )
    assert found.misfit < 0.01


def test_noise_gives_errors_within_their_bounds() -> None:
    found = _found(keyframes(sensor(noise=1.0), count=20, noise=1.0))
    states, sigma = found.states, np.sqrt(found.covariance[-1][LOG_SCALE, LOG_SCALE])
    error = abs(np.exp(states.log_scale[-1]) / 0.5 - 1.0)
    assert error < 0.01 and error < 3.0 * sigma < 0.03
    assert np.abs(states.gyro_bias[-1] - GYRO_BIAS).max() < 0.05 * np.linalg.norm(GYRO_BIAS)
    assert np.abs(states.accel_bias[-1] - ACCEL_BIAS).max() < 0.03
    assert _tilt_deg(found, 20).max() < 0.3
    assert tilt_sigma(states.rotation[-1], found.covariance[-1]) < np.radians(0.3)


def test_a_metric_map_keeps_its_scale() -> None:
    found = _found(keyframes(sensor(), count=8, scale=1.0, metric=True))
    np.testing.assert_allclose(found.states.log_scale, 0.0, atol=1e-6)
    assert _tilt_deg(found, 8).max() < 0.02


def test_first_camera_is_the_origin_and_looks_along_x() -> None:
    given = keyframes(sensor())
    found = _found(given)
    to_imu = given.imu_from_cam
    camera = found.states.position[0] + found.states.rotation[0] @ to_imu[:3, 3]
    np.testing.assert_allclose(camera, 0.0, atol=1e-4)
    forward = found.states.rotation[0] @ to_imu[:3, 2]
    assert abs(forward[1]) < 1e-4 and forward[0] > 0.9


def test_too_few_keyframes_are_told() -> None:
    assert initial_estimate(keyframes(sensor(), count=3)) is NotYet.FEW_KEYFRAMES


def test_motion_without_acceleration_does_not_determine_the_scale() -> None:
    given = keyframes(sensor())
    rate = np.zeros_like(given.intervals[0].gyro)
    force = np.tile([0.0, 0.0, 9.81], (len(rate), 1))
    still = tuple(
        replace(i, gyro=rate[: len(i.gyro)], accel=force[: len(i.accel)]) for i in given.intervals
    )
    poses = np.tile(np.eye(4), (16, 1, 1))
    poses[:, 2, 3] = np.arange(16)
    found = initial_estimate(replace(given, intervals=still, world_from_cam=poses))
    assert found in (NotYet.NO_MOTION, NotYet.NO_GRAVITY)


@pytest.mark.parametrize("axes", [(-1.0, 1.0, 1.0), (1.0, -1.0, -1.0)])
def test_a_wrong_mounting_is_told(axes: tuple[float, float, float]) -> None:
    source = sensor()
    given = source.samples
    flipped = Samples(given.stamps_ns, given.gyro * axes, given.accel * axes)
    assert initial_estimate(keyframes(replace(source, samples=flipped))) in (
        NotYet.WRONG_ROTATION,
        NotYet.NO_GRAVITY,
        NotYet.DISAGREEMENT,
    )


def test_another_clock_is_told() -> None:
    source = sensor()
    given = source.samples
    late = Samples(given.stamps_ns, np.roll(given.gyro, 80, 0), np.roll(given.accel, 80, 0))
    assert isinstance(initial_estimate(keyframes(replace(source, samples=late))), NotYet)


def test_a_camera_that_looks_down_has_the_heading_of_its_upper_edge() -> None:
    looking_down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    turn = upright(looking_down, np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose(turn @ looking_down @ [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(turn @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_true_poses_are_those_of_the_camera() -> None:
    """Of the simulation: the lever arm counts."""
    poses = world_from_cam(keyframe_stamps(2))
    assert np.linalg.norm(poses[0, :3, 3] - path(np.array([0.1]))[1][0]) > 0.05
