"""Unknowns of the calibration of an inertial sensor on a camera, and small steps of them."""

from __future__ import annotations

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
