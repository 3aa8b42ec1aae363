"""Residuals of inertial and visual measurements between consecutive states, with derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.geometry import so3
from vo.geometry.transforms import skew
from vo.inertial.preintegration import Preintegrated
from vo.inertial.states import (
    ACCEL_BIAS,
    GRAVITY_M_S2,
    GYRO_BIAS,
    LOG_SCALE,
    POSITION,
    ROTATION,
    VELOCITY,
    WIDTH,
    States,
)
from vo.types import Floats

_GRAVITY = np.array([0.0, 0.0, -GRAVITY_M_S2])


class Linearised(NamedTuple):
    """Residuals and their derivatives by the states at both ends.

    Attributes:
        residual: (n, m).
        first: (n, m, WIDTH) by the earlier state.
        second: (n, m, WIDTH) by the later one.
    """

    residual: Floats
    first: Floats
    second: Floats


def inertial_residuals(
    before: States, after: States, measured: tuple[Preintegrated, ...]
) -> Linearised:
    """Residuals (n, 9) of rotation, velocity and position.

    Source: Forster et al. 2017, eq. 45; derivatives: its supplement.
    """
    duration = np.array([m.duration_s for m in measured])[:, None]
    jacobian = np.stack([m.jacobian for m in measured])
    off_gyro = before.gyro_bias - np.stack([m.gyro_bias for m in measured])
    off_accel = before.accel_bias - np.stack([m.accel_bias for m in measured])
    bias = np.concatenate([off_gyro, off_accel], axis=1)
    correction = np.einsum("nij,nj->ni", jacobian, bias)
    rotation = np.stack([m.rotation for m in measured]) @ so3.exp(correction[:, :3])
    to_first = np.swapaxes(before.rotation, 1, 2)
    relative = to_first @ after.rotation
    turned = so3.log(np.swapaxes(rotation, 1, 2) @ relative)
    faster = _rotated(to_first, after.velocity - before.velocity - _GRAVITY * duration)
    way = after.position - before.position - before.velocity * duration
    way = _rotated(to_first, way - 0.5 * _GRAVITY * duration**2)
    velocity = np.stack([m.velocity for m in measured]) + correction[:, 3:6]
    position = np.stack([m.position for m in measured]) + correction[:, 6:]
    residual = np.concatenate([turned, faster - velocity, way - position], axis=1)
    count = len(measured)
    first, second = np.zeros((2, count, 9, WIDTH))
    unturned = so3.inverse_right_jacobian(turned)
    first[:, 0:3, ROTATION] = -unturned @ np.swapaxes(relative, 1, 2)
    second[:, 0:3, ROTATION] = unturned
    of_bias = -so3.inverse_right_jacobian(-turned) @ so3.right_jacobian(correction[:, :3])
    first[:, 0:3, GYRO_BIAS] = of_bias @ jacobian[:, :3, :3]
    first[:, 3:6, ROTATION] = skew(faster)
    first[:, 6:9, ROTATION] = skew(way)
    first[:, 3:6, VELOCITY], second[:, 3:6, VELOCITY] = -to_first, to_first
    first[:, 6:9, VELOCITY] = -to_first * duration[:, None]
    first[:, 6:9, POSITION], second[:, 6:9, POSITION] = -to_first, to_first
    first[:, 3:9, GYRO_BIAS] = -jacobian[:, 3:, :3]
    first[:, 3:9, ACCEL_BIAS] = -jacobian[:, 3:, 3:]
    return Linearised(residual, first, second)


def visual_residuals(
    before: States, after: States, visual: Floats, imu_from_cam: Floats
) -> Linearised:
    """Residuals (n, 6) of the motions of the camera, as tangents on the right, in map units.

    The motions by images have errors, so that their length does not appear in any derivative:
    multiplied by the scale, as the residual in metres would have it, they make the scale too small.

    Args:
        before: n states.
        after: n states.
        visual: (n, 4, 4) earlier_from_later of the camera, in map units.
        imu_from_cam: (4, 4).
    """
    to_imu, lever = imu_from_cam[:3, :3], imu_from_cam[:3, 3]
    cam_before, cam_after = before.rotation @ to_imu, after.rotation @ to_imu
    to_before, back = np.swapaxes(cam_before, 1, 2), np.swapaxes(visual[:, :3, :3], 1, 2)
    relative = to_before @ cam_after
    turned = so3.log(back @ relative)
    way = after.position - before.position
    way = way + (after.rotation - before.rotation) @ lever
    units = np.exp(-before.log_scale)  # of the map, of one metre
    moved = units[:, None] * _rotated(to_before, way)
    residual = np.concatenate([turned, _rotated(back, moved - visual[:, :3, 3])], axis=1)
    first, second = np.zeros((2, len(visual), 6, WIDTH))
    unturned = so3.inverse_right_jacobian(turned)
    first[:, 0:3, ROTATION] = -unturned @ np.swapaxes(cam_after, 1, 2) @ before.rotation
    second[:, 0:3, ROTATION] = unturned @ to_imu.T
    in_imu = _rotated(np.swapaxes(before.rotation, 1, 2), way)
    of_arm = skew(np.broadcast_to(lever, way.shape))
    first[:, 3:6, ROTATION] = units[:, None, None] * (back @ to_imu.T @ (skew(in_imu) + of_arm))
    to_after = units[:, None, None] * (back @ to_before)
    second[:, 3:6, ROTATION] = -to_after @ after.rotation @ of_arm
    first[:, 3:6, POSITION], second[:, 3:6, POSITION] = -to_after, to_after
    first[:, 3:6, LOG_SCALE] = -_rotated(back, moved)
    return Linearised(residual, first, second)


def _rotated(rotations: Floats, vectors: Floats) -> Floats:
    return np.asarray(np.einsum("nij,nj->ni", rotations, vectors))
