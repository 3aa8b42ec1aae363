"""Unknowns, increments of samples and normal equations of an inertial sensor on a camera.

Source of the increments: Forster et al., "On-manifold preintegration for real-time visual-inertial
odometry", 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import so3_exp
from vo.base.types import Floats
from vo.engine.geometry.so3 import exp_rows

_GRAVITY_M_S2 = 9.80665
STATE, COMMON = 9, 15
ROTATION, TRANSLATION, OFFSET = slice(0, 3), slice(3, 6), 6
_GYRO_BIAS, _ACCEL_BIAS, _TILT = slice(7, 10), slice(10, 13), slice(13, 15)


class States(NamedTuple):
    """Poses and velocities of the sensor relative to the board: (N, 3, 3), (N, 3), (N, 3)."""

    rotation: Floats
    position: Floats
    velocity: Floats

    def moved(self, step: Floats) -> States:
        """By steps (N, 9): rotation in the frame of the sensor, position, velocity."""
        return States(
            self.rotation @ exp_rows(step[:, :3]),
            self.position + step[:, 3:6],
            self.velocity + step[:, 6:],
        )

    def part(self, rows: slice) -> States:
        """Those of some images."""
        return States(*(values[rows] for values in self))


class Common(NamedTuple):
    """Unknowns that all images share."""

    rotation: Floats  # (3, 3) cam_from_imu
    translation: Floats  # (3,) of it
    offset_s: float
    gyro_bias: Floats  # (3,)
    accel_bias: Floats  # (3,)
    up: Floats  # (3, 3) rotation that takes z to up in the frame of the board

    def moved(self, step: Floats) -> Common:
        """By a step (15,)."""
        tilt = np.array([step[_TILT][0], step[_TILT][1], 0.0])
        return Common(
            so3_exp(step[ROTATION]) @ self.rotation,
            self.translation + step[TRANSLATION],
            self.offset_s + float(step[OFFSET]),
            self.gyro_bias + step[_GYRO_BIAS],
            self.accel_bias + step[_ACCEL_BIAS],
            self.up @ so3_exp(tilt),
        )

    @property
    def gravity(self) -> Floats:
        """(3,) in the frame of the board."""
        return np.asarray(-_GRAVITY_M_S2 * self.up[:, 2])


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


@dataclass(eq=False)
class BorderedSystem:
    """Normal equations of N states with S unknowns each, and of C common unknowns."""

    diagonal: Floats  # (N, S, S)
    next: Floats  # (N - 1, S, S) between a state and the next one
    border: Floats  # (N, S, C) between a state and the common unknowns
    corner: Floats  # (C, C)
    right: Floats  # (N, S) gradient of the states
    right_common: Floats  # (C,) that of the common unknowns

    @classmethod
    def empty(cls, count: int, size: int, common: int) -> BorderedSystem:
        """All zero."""
        return cls(
            np.zeros((count, size, size)),
            np.zeros((count - 1, size, size)),
            np.zeros((count, size, common)),
            np.zeros((common, common)),
            np.zeros((count, size)),
            np.zeros(common),
        )

    def solve(self, damping: float) -> tuple[Floats, Floats, Floats]:
        """Eliminate the states one by one.

        Returns (N, S) steps of the states, (C,) step of the common unknowns, and the (C, C)
        information of the common unknowns.
        """
        count, size = self.right.shape
        common = len(self.right_common)
        known = np.concatenate([self.border, self.right[:, :, None]], axis=2)
        damped = self.diagonal * (1.0 + damping * np.eye(size))
        solved = np.zeros((count, size, size + common + 1))
        corner = self.corner * (1.0 + damping * np.eye(common))
        right_common = self.right_common.copy()
        block, rest = damped[0], known[0]
        for k in range(count):
            following = self.next[k] if k + 1 < count else np.zeros((size, size))
            solved[k] = np.linalg.solve(block, np.hstack([following, rest]))
            corner = corner - rest[:, :common].T @ solved[k][:, size:-1]
            right_common = right_common - rest[:, :common].T @ solved[k][:, -1]
            if k + 1 < count:
                block = damped[k + 1] - following.T @ solved[k][:, :size]
                rest = known[k + 1] - following.T @ solved[k][:, size:]
        of_common = np.linalg.solve(corner, right_common)
        of_states = np.zeros((count, size))
        after = np.zeros(size)
        for k in range(count - 1, -1, -1):
            after = (
                solved[k][:, -1] - solved[k][:, size:-1] @ of_common - solved[k][:, :size] @ after
            )
            of_states[k] = after
        return of_states, np.asarray(of_common), corner
