"""Residuals of inertial and visual measurements between consecutive states, with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats
from vo.engine.inertial.factor_kernels import inertial_factors, visual_factors
from vo.engine.inertial.preintegration import Preintegrated
from vo.engine.inertial.states import GRAVITY_M_S2, States


class Linearised(NamedTuple):
    """Residuals and their derivatives by the states at both ends."""

    residual: Floats  # (n, m)
    first: Floats  # (n, m, WIDTH) by the earlier state
    second: Floats  # (n, m, WIDTH) by the later one


class Motions(NamedTuple):
    """n preintegrated motions as arrays."""

    duration_s: Floats  # (n,)
    rotation: Floats  # (n, 3, 3)
    moved: Floats  # (n, 6) velocity and position
    jacobian: Floats  # (n, 9, 6) as of `Preintegrated`, as the biases are
    gyro_bias: Floats  # (n, 3)
    accel_bias: Floats  # (n, 3)


def as_arrays(measured: Sequence[Preintegrated]) -> Motions:
    """At least one motion as arrays."""
    return Motions(
        np.array([m.duration_s for m in measured]),
        np.array([m.rotation for m in measured]),
        np.array([[m.velocity, m.position] for m in measured]).reshape(-1, 6),
        np.array([m.jacobian for m in measured]),
        np.array([m.gyro_bias for m in measured]),
        np.array([m.accel_bias for m in measured]),
    )


def inertial_residuals(before: States, after: States, motions: Motions) -> Linearised:
    """Residuals (n, 9) of rotation, velocity and position.

    Source: Forster et al. 2017, eq. 45; derivatives: its supplement.
    """
    found = inertial_factors(
        tuple(np.ascontiguousarray(f) for f in before[:3]),
        tuple(np.ascontiguousarray(f) for f in after[:3]),
        np.ascontiguousarray(before.gyro_bias),
        np.ascontiguousarray(before.accel_bias),
        *motions,
        -GRAVITY_M_S2,
    )
    return Linearised(*found)


def visual_residuals(
    before: States, after: States, visual: Floats, imu_from_cam: Floats
) -> Linearised:
    """Residuals (n, 6) of the motions of the camera, as tangents on the right, in map units.

    The motions by images have errors, so that their length does not appear in any derivative:
    multiplied by the scale, as the residual in metres would have it, they make the scale too small.
    `visual`: (n, 4, 4) earlier_from_later, in map units.
    """
    fields = before.rotation, before.position, before.log_scale, after.rotation, after.position
    mounting = imu_from_cam[:3, :3], imu_from_cam[:3, 3]
    found = visual_factors(*(np.ascontiguousarray(each) for each in (*fields, visual, *mounting)))
    return Linearised(*found)
