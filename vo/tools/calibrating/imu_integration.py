"""Integration of inertial samples over many intervals at once.

Source: Forster et al., "On-manifold preintegration for real-time visual-inertial odometry", 2017.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.types import Floats
from vo.engine.geometry.so3 import exp_rows


class Increments(NamedTuple):
    """What samples alone tell of M intervals, in the frame of the sensor at their starts."""

    rotation: Floats  # (M, 3, 3) start_from_end
    velocity: Floats  # (M, 3) change of the velocity without gravity
    position: Floats  # (M, 3) change of the position without gravity and the first velocity


class Samples:
    """Samples with times in seconds, taken as linear in between."""

    def __init__(self, times_s: Floats, gyro: Floats, accel: Floats) -> None:
        """Store (N,) times, (N, 3) rad/s and (N, 3) m/s²."""
        self.times_s, self._gyro, self._accel = times_s, gyro, accel
        self.interval_s = float(np.median(np.diff(times_s)))

    def integrate(
        self, first_s: Floats, last_s: Floats, gyro_bias: Floats, accel_bias: Floats
    ) -> Increments:
        """Integrate over intervals (M,), in steps of at most half the time between samples."""
        longest = float((last_s - first_s).max())
        steps = max(2, int(np.ceil(2.0 * longest / self.interval_s)))
        parts = np.linspace(0.0, 1.0, steps + 1)
        times = first_s[:, None] + (last_s - first_s)[:, None] * parts
        gyro, accel = (
            np.stack([np.interp(times, self.times_s, axis) for axis in values.T], axis=2)
            for values in (self._gyro - gyro_bias, self._accel - accel_bias)
        )
        step = ((last_s - first_s) / steps)[:, None]
        rotation = np.tile(np.eye(3), (len(first_s), 1, 1))
        velocity = np.zeros((len(first_s), 3))
        position = np.zeros_like(velocity)
        for k in range(steps):
            turned = rotation @ exp_rows(0.5 * step * (gyro[:, k] + gyro[:, k + 1]))
            before = np.einsum("nij,nj->ni", rotation, accel[:, k])
            after = np.einsum("nij,nj->ni", turned, accel[:, k + 1])
            position = position + step * velocity + step**2 * (before / 3.0 + after / 6.0)
            velocity = velocity + 0.5 * step * (before + after)
            rotation = turned
        return Increments(rotation, velocity, position)
