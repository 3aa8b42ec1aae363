"""Motion between two known poses by the samples in between alone, such as through lost frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.types import Floats, ImuNoise, Ints
from vo.engine.inertial.estimation import Prior, estimate_states
from vo.engine.inertial.preintegration import Preintegrated, preintegrate
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import (
    ACCEL_BIAS,
    GYRO_BIAS,
    LOG_SCALE,
    POSITION,
    ROTATION,
    VELOCITY,
    WIDTH,
    States,
    Steps,
    joined,
    predicted_motion,
)

# Standard deviations at both ends: poses are known, and an unknown velocity.
_KNOWN_RAD, _KNOWN_M, _ANY_M_S = 1e-4, 1e-4, 100.0
_MIN_SIGMA = 1e-6  # of velocities and biases


class EndState(NamedTuple):
    """A known pose at one end, and what is known of the motion there."""

    stamp_ns: int  # its time
    world_from_imu: Floats  # (4, 4) in a world whose z axis points up, m
    velocity: Floats | None  # (3,) m/s in that world, None if it is unknown
    gyro_bias: Floats  # (3,) rad/s
    accel_bias: Floats  # (3,) m/s²
    covariance: Floats  # (9, 9) of velocity and biases


class Bridge(NamedTuple):
    """Poses between two ends."""

    world_from_imu: Floats  # (n, 4, 4)
    # (n, 6, 6) relative to the ends: rotation as a tangent on the right, position in the world
    covariance: Floats


def bridge(
    first: EndState, last: EndState, stamps_ns: Ints, reader: SampleReader, noise: ImuNoise
) -> Bridge | None:
    """The most probable poses at times between two ends; None where samples are missing.

    The motion begins at the first end and is corrected so that it ends at the last one. The
    difference is spread in proportion to the uncertainty, as by a Kalman smoother.
    `stamps_ns`: (n,) increasing, between both.
    """
    assert first.velocity is not None
    times = [first.stamp_ns, *stamps_ns.tolist(), last.stamp_ns]
    steps: list[Preintegrated] = []
    for begin, end in zip(times[:-1], times[1:], strict=True):
        interval = reader.between(begin, end)
        if interval is None:
            return None
        steps.append(preintegrate(interval, first.gyro_bias, first.accel_bias, noise))
    states = _state(first, first.velocity)
    for step in steps:
        rotation, position, velocity = predicted_motion(states.rows(slice(-1, None)), step)
        moved = states.rows(slice(-1, None))._replace(
            rotation=rotation[None], position=position[None], velocity=velocity[None]
        )
        states = joined(states, moved)
    at_end = states.velocity[-1] if last.velocity is None else last.velocity
    try:
        ends = _prior(first, first.velocity), _prior(last, at_end)
        estimate = estimate_states(states, _only_inertial(steps), ends[0], noise, ends[1])
    except np.linalg.LinAlgError:
        return None
    poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
    poses[:, :3, :3] = estimate.states.rotation[1:-1]
    poses[:, :3, 3] = estimate.states.position[1:-1]
    return Bridge(poses, estimate.covariance[1:-1, :6, :6])


def moved_to(end: EndState, to: EndState, reader: SampleReader, noise: ImuNoise) -> EndState | None:
    """The pose `to` with the velocity by that of an end before or after it."""
    if end.stamp_ns == to.stamp_ns:
        return end
    is_later = to.stamp_ns > end.stamp_ns
    early, late = (end, to) if is_later else (to, end)
    interval = reader.between(early.stamp_ns, late.stamp_ns)
    if interval is None or end.velocity is None:
        return None
    step = preintegrate(interval, end.gyro_bias, end.accel_bias, noise)
    at_rest = _state(early, np.zeros(3))
    change = predicted_motion(at_rest, step)[2]
    velocity = end.velocity + change if is_later else end.velocity - change
    covariance = end.covariance.copy()
    rotation = early.world_from_imu[:3, :3]
    # Of the samples, and of the biases, whose correlation with the velocity is not kept.
    by_bias = rotation @ step.jacobian[3:6]
    added = rotation @ step.covariance[3:6, 3:6] @ rotation.T
    covariance[:3, :3] += added + by_bias @ end.covariance[3:, 3:] @ by_bias.T
    covariance[:3, 3:] = covariance[3:, :3] = 0.0
    return end._replace(
        stamp_ns=to.stamp_ns,
        world_from_imu=to.world_from_imu,
        velocity=velocity,
        covariance=covariance,
    )


def _state(end: EndState, velocity: Floats) -> States:
    return States(
        end.world_from_imu[None, :3, :3],
        end.world_from_imu[None, :3, 3],
        velocity[None],
        end.gyro_bias[None],
        end.accel_bias[None],
        np.zeros(1),
    )


def _prior(end: EndState, velocity: Floats) -> Prior:
    """What is known of the state at an end."""
    information = np.zeros((WIDTH, WIDTH))
    information[ROTATION, ROTATION] = np.eye(3) / _KNOWN_RAD**2
    information[POSITION, POSITION] = np.eye(3) / _KNOWN_M**2
    information[LOG_SCALE, LOG_SCALE] = 1.0
    covariance = end.covariance + _MIN_SIGMA**2 * np.eye(9)
    if end.velocity is None:
        covariance[:3] = covariance[:, :3] = 0.0
        covariance[:3, :3] = _ANY_M_S**2 * np.eye(3)
    motion = slice(VELOCITY.start, ACCEL_BIAS.stop)
    assert motion.stop - motion.start == 9 and GYRO_BIAS.start == VELOCITY.stop
    information[motion, motion] = np.linalg.inv(covariance)
    return Prior(_state(end, velocity), information, np.zeros(WIDTH))


def _only_inertial(steps: list[Preintegrated]) -> Steps:
    count = len(steps)
    return Steps(
        np.array([step.duration_s for step in steps]),
        tuple(steps),
        np.tile(np.eye(4), (count, 1, 1)),
        np.zeros((count, 6, 6)),
        np.zeros(count, dtype=bool),
        True,
        np.eye(4),
    )
