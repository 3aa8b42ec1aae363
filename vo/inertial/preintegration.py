"""Preintegration of inertial samples between two times.

All sums are over the samples of one interval, in the frame of the sensor at its start.
Source: Forster et al., "On-manifold preintegration for real-time visual-inertial odometry", 2017,
sec. VI; the sums over samples replace its recursions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.geometry import so3
from vo.geometry.transforms import skew
from vo.types import Floats, ImuNoise

# Errors of interpolation and integration in each interval, which no noise density contains.
_FLOOR = (1e-5, 1e-4, 1e-4)  # rad, m/s, m


@dataclass(frozen=True, eq=False)
class Interval:
    """Samples of an inertial sensor from one time to another, both ends included.

    Attributes:
        seconds: (n + 1,) since the start, increasing from 0.
        gyro: (n + 1, 3) rad/s.
        accel: (n + 1, 3) m/s².
    """

    seconds: Floats
    gyro: Floats
    accel: Floats

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample."""
        return float(self.seconds[-1])


@dataclass(frozen=True, eq=False)
class Preintegrated:
    """Motion of a sensor in an interval, without gravity and velocity at its start.

    Attributes:
        duration_s: of the interval.
        rotation: (3, 3) start_from_end.
        velocity: (3,) change of velocity, m/s, in the frame at the start.
        position: (3,) m, the same.
        jacobian: (9, 6) of (rotation, velocity, position) by the biases (gyro, accel); the
            rotation's rows are a tangent on its right.
        covariance: (9, 9) by noise, and by the walk of the biases within the interval.
        gyro_bias: (3,) rad/s that was subtracted.
        accel_bias: (3,) m/s² that was subtracted.
    """

    duration_s: float
    rotation: Floats
    velocity: Floats
    position: Floats
    jacobian: Floats
    covariance: Floats
    gyro_bias: Floats
    accel_bias: Floats


def preintegrate(
    interval: Interval, gyro_bias: Floats, accel_bias: Floats, noise: ImuNoise
) -> Preintegrated:
    """Integrate the samples of an interval; rates and forces are linear between samples."""
    seconds = interval.seconds
    dt, total = np.diff(seconds), float(seconds[-1])
    rate = 0.5 * (interval.gyro[1:] + interval.gyro[:-1]) - gyro_bias
    turns = so3.exp(rate * dt[:, None])
    rotations = so3.running_products(turns)
    force = np.einsum("nij,nj->ni", rotations, interval.accel - accel_bias)
    step = dt[:, None]
    velocity = _running_sum(0.5 * (force[:-1] + force[1:]) * step)
    moved = velocity[:-1] * step + (2.0 * force[:-1] + force[1:]) * step**2 / 6.0
    position = _running_sum(moved)
    left = (total - seconds[1:])[:, None]  # time after each step
    later_velocity = velocity[-1] - velocity[1:] + 0.5 * force[1:] * step
    later_position = position[-1] - position[1:] - velocity[1:] * left
    later_position += force[1:] * (step**2 / 6.0 + 0.5 * step * left)
    # Effects (9, 3) on the result of an error in the rate of each step, and in each force.
    turned = rotations[1:] @ so3.right_jacobian(rate * step) * dt[:, None, None]
    end = rotations[-1]
    of_rate = np.concatenate(
        [-end.T @ turned, skew(later_velocity) @ turned, skew(later_position) @ turned], axis=1
    )
    in_velocity, in_position = _force_weights(dt, seconds, total)
    of_force = np.zeros((len(seconds), 9, 3))
    of_force[:, 3:6] = -rotations * in_velocity[:, None, None]
    of_force[:, 6:9] = -rotations * in_position[:, None, None]
    covariance = _weighted(of_rate, noise.gyro_noise**2 / dt)
    covariance += _weighted(of_force, noise.accel_noise**2 / in_velocity)
    covariance += _walk_covariance(noise, total)
    return Preintegrated(
        total,
        end,
        velocity[-1],
        position[-1],
        np.concatenate([of_rate.sum(axis=0), of_force.sum(axis=0)], axis=1),
        covariance,
        gyro_bias,
        accel_bias,
    )


def rotation_of(interval: Interval, gyro_bias: Floats) -> Floats:
    """(3, 3) start_from_end of an interval, by its rates alone."""
    rate = 0.5 * (interval.gyro[1:] + interval.gyro[:-1]) - gyro_bias
    turns = so3.exp(rate * np.diff(interval.seconds)[:, None])
    return np.asarray(so3.running_products(turns)[-1])


def _running_sum(steps: Floats) -> Floats:
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _force_weights(dt: Floats, seconds: Floats, total: float) -> tuple[Floats, Floats]:
    """Weights (n + 1,) of each force in the final velocity and position."""
    after = total - seconds[1:]
    in_velocity, in_position = np.zeros((2, len(seconds)))
    in_velocity[:-1] += 0.5 * dt
    in_velocity[1:] += 0.5 * dt
    in_position[:-1] += dt**2 / 3.0 + 0.5 * dt * after
    in_position[1:] += dt**2 / 6.0 + 0.5 * dt * after
    return in_velocity, in_position


def _weighted(effects: Floats, variance: Floats) -> Floats:
    """Sum of the covariances of effects (n, 9, 3) of independent errors."""
    scaled = effects * variance[:, None, None]
    return np.asarray(np.einsum("nij,nkj->ik", scaled, effects))


def _walk_covariance(noise: ImuNoise, duration_s: float) -> Floats:
    """Covariance (9, 9) by biases that walk within the interval, and a floor."""
    gyro, accel = noise.gyro_walk**2, noise.accel_walk**2
    diagonal = np.repeat(np.square(_FLOOR), 3)
    diagonal[:3] += gyro * duration_s**3 / 3.0
    diagonal[3:6] += accel * duration_s**3 / 3.0
    diagonal[6:] += accel * duration_s**5 / 20.0
    return np.diag(diagonal)
