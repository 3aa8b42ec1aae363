"""Preintegration of inertial samples between two times.

All sums are over the samples of one interval, in the frame of the sensor at its start
(`sample_kernels.py`). Source: Forster et al., "On-manifold preintegration for real-time
visual-inertial odometry", 2017, sec. VI; the sums over samples replace its recursions.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Floats, ImuNoise
from vo.engine.inertial.sample_kernels import integrated, turned

# Errors of interpolation and integration in each interval, which no noise density contains.
_FLOOR = (1e-5, 1e-4, 1e-4)  # rad, m/s, m
_BRIDGED = (0.2, 2.0)  # rad/s and m/s², errors of samples that are interpolated


@frozen(eq=False)
class Interval:
    """Samples of an inertial sensor from one time to another, both ends included."""

    seconds: Floats  # (n + 1,) since the start, increasing from 0
    gyro: Floats  # (n + 1, 3) rad/s
    accel: Floats  # (n + 1, 3) m/s²
    bridged_s: float = 0.0  # time without good samples, in which they are interpolated

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample."""
        return float(self.seconds[-1])


@frozen(eq=False)
class Preintegrated:
    """Motion of a sensor in an interval, without gravity and velocity at its start."""

    duration_s: float  # of the interval
    rotation: Floats  # (3, 3) start_from_end
    velocity: Floats  # (3,) change of velocity, m/s, in the frame at the start
    position: Floats  # (3,) m, the same
    # (9, 6) of (rotation, velocity, position) by the biases (gyro, accel); the rotation's rows are
    # a tangent on its right
    jacobian: Floats
    covariance: Floats  # (9, 9) by noise, and by the walk of the biases within the interval
    gyro_bias: Floats  # (3,) rad/s that was subtracted
    accel_bias: Floats  # (3,) m/s² that was subtracted

    @cached_property
    def information(self) -> Floats:
        """Inverse of the covariance."""
        return np.asarray(np.linalg.inv(self.covariance), np.float64)


def preintegrate(
    interval: Interval, gyro_bias: Floats, accel_bias: Floats, noise: ImuNoise
) -> Preintegrated:
    """Integrate the samples of an interval; rates and forces are linear between samples."""
    total = interval.duration_s
    rotation, velocity, position, jacobian, covariance = integrated(
        np.ascontiguousarray(interval.seconds),
        np.ascontiguousarray(interval.gyro),
        np.ascontiguousarray(interval.accel),
        np.ascontiguousarray(gyro_bias),
        np.ascontiguousarray(accel_bias),
        noise.gyro_noise**2,
        noise.accel_noise**2,
    )
    covariance += _walk_covariance(noise, total)
    if interval.bridged_s > 0.0:
        covariance += _bridge_covariance(interval.bridged_s, total)
    return Preintegrated(
        *(total, rotation, velocity, position, jacobian, covariance, gyro_bias, accel_bias)
    )


def rotation_of(interval: Interval, gyro_bias: Floats) -> Floats:
    """(3, 3) start_from_end of an interval, by its rates alone."""
    rotation: Floats = turned(
        np.ascontiguousarray(interval.seconds),
        np.ascontiguousarray(interval.gyro),
        np.ascontiguousarray(gyro_bias),
    )
    return rotation


def _walk_covariance(noise: ImuNoise, duration_s: float) -> Floats:
    """Covariance (9, 9) by biases that walk within the interval, and a floor."""
    gyro, accel = noise.gyro_walk**2, noise.accel_walk**2
    diagonal = np.repeat(np.square(_FLOOR), 3)
    diagonal[:3] += gyro * duration_s**3 / 3.0
    diagonal[3:6] += accel * duration_s**3 / 3.0
    diagonal[6:] += accel * duration_s**5 / 20.0
    return np.diag(diagonal)


def _bridge_covariance(bridged_s: float, duration_s: float) -> Floats:
    """Covariance (9, 9) by a time without samples, wherever it lies in the interval."""
    turn, change = _BRIDGED[0] * bridged_s, _BRIDGED[1] * bridged_s
    return np.diag(np.repeat(np.square([turn, change, change * duration_s]), 3))
