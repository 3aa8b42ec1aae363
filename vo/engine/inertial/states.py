"""States of an inertial sensor at the keyframes, and what was measured between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Bools, Floats
from vo.engine.geometry import so3
from vo.engine.inertial.preintegration import Preintegrated

GRAVITY_M_S2 = 9.81
GRAVITY = np.array([0.0, 0.0, -GRAVITY_M_S2])

# Columns of the tangent of a state.
ROTATION, POSITION, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
LOG_SCALE = 15
WIDTH = 16


class States(NamedTuple):
    """States at n keyframes, in a world whose z axis points up."""

    rotation: Floats  # (n, 3, 3) world_from_imu
    position: Floats  # (n, 3) m
    velocity: Floats  # (n, 3) m/s
    gyro_bias: Floats  # (n, 3) rad/s
    accel_bias: Floats  # (n, 3) m/s²
    log_scale: Floats  # (n,) logarithm of the metres of one unit of the visual map

    @property
    def number(self) -> int:
        """How many there are."""
        return len(self.position)

    def rows(self, rows: slice) -> States:
        """Some of the states."""
        return States(*(field[rows] for field in self))

    def moved(self, step: Floats) -> States:
        """States after a step (n, WIDTH); rotations are moved on their right."""
        return States(
            self.rotation @ so3.exp(step[:, ROTATION]),
            self.position + step[:, POSITION],
            self.velocity + step[:, VELOCITY],
            self.gyro_bias + step[:, GYRO_BIAS],
            self.accel_bias + step[:, ACCEL_BIAS],
            self.log_scale + step[:, LOG_SCALE],
        )

    def since(self, other: States) -> Floats:
        """The step (n, WIDTH) from other states to these."""
        turned = so3.log(np.swapaxes(other.rotation, 1, 2) @ self.rotation)
        return np.concatenate(
            [
                turned,
                self.position - other.position,
                self.velocity - other.velocity,
                self.gyro_bias - other.gyro_bias,
                self.accel_bias - other.accel_bias,
                (self.log_scale - other.log_scale)[:, None],
            ],
            axis=1,
        )


def joined(first: States, second: States) -> States:
    """States of one, then of the other."""
    return States(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))


class MapErrors(NamedTuple):
    """Standard deviations of what the windows of one camera do not tell of their motions."""

    ratio: float = 0.001  # of a motion, relative to its length
    drift: float = 0.0012  # change of the logarithm of the scale from one motion to the next


@frozen(eq=False)
class Steps:
    """Measurements between n + 1 consecutive keyframes."""

    duration_s: Floats  # (n,) times from each to the next
    # n motions by the inertial sensor, None where samples are missing
    inertial: tuple[Preintegrated | None, ...]
    visual: Floats  # (n, 4, 4) motions of the camera in the units of the map, earlier_from_later
    covariance: Floats  # (n, 6, 6) theirs: tangent on the right, rotation first, in map units
    is_visual: Bools  # (n,) whether both keyframes are of one segment
    is_metric: bool  # whether the unit of the map is the metre
    imu_from_cam: Floats  # (4, 4)
    errors: MapErrors = MapErrors()  # of one camera's motions, beside `covariance`


def predicted_motion(last: States, measured: Preintegrated) -> tuple[Floats, Floats, Floats]:
    """Rotation, position and velocity at the end of an interval that begins at a state (1)."""
    bias = np.concatenate(
        [
            last.gyro_bias[0] - measured.gyro_bias,
            last.accel_bias[0] - measured.accel_bias,
        ]
    )
    change = measured.jacobian @ bias
    duration, first = measured.duration_s, last.rotation[0]
    rotation = first @ measured.rotation @ so3.exp(change[:3])
    velocity = last.velocity[0] + GRAVITY * duration + first @ (measured.velocity + change[3:6])
    position = last.position[0] + last.velocity[0] * duration + 0.5 * GRAVITY * duration**2
    position = position + first @ (measured.position + change[6:])
    return rotation, position, velocity
