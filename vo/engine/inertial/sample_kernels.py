"""Sums over the samples of an interval, as compiled loops."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.engine.inertial.rotation_kernels import (
    exp_into,
    identity_into,
    product_into,
    right_jacobian_into,
)


@compiled
def turned(seconds, gyro, bias):  # type: ignore[no-untyped-def]
    """(3, 3) start_from_end of n samples, by their rates alone.

    Args:
        seconds: (n,) increasing.
        gyro: (n, 3) rad/s.
        bias: (3,) rad/s.
    """
    rotation, after = np.zeros((3, 3)), np.zeros((3, 3))
    turn, angle = np.empty((3, 3)), np.empty(3)
    identity_into(rotation)
    for k in range(1, len(seconds)):
        dt = seconds[k] - seconds[k - 1]
        for i in range(3):
            angle[i] = (0.5 * (gyro[k, i] + gyro[k - 1, i]) - bias[i]) * dt
        exp_into(angle, turn)
        product_into(rotation, turn, after)
        rotation, after = after, rotation
    return rotation


@compiled
def integrated(  # type: ignore[no-untyped-def]
    seconds, gyro, accel, gyro_bias, accel_bias, gyro_density, accel_density
):
    """Motion in an interval of n samples; rates and forces are linear between them.

    Args:
        seconds: (n,) since the start.
        gyro: (n, 3) rad/s.
        accel: (n, 3) m/s².
        gyro_bias: (3,) rad/s.
        accel_bias: (3,) m/s².
        gyro_density: noise of the rates, squared.
        accel_density: noise of the forces, squared.

    Returns:
        Rotation (3, 3), velocity (3,), position (3,), jacobian (9, 6) and the covariance (9, 9) by
        noise, as in `Preintegrated`.
    """
    count = len(seconds)
    rotation, force = np.zeros((count, 3, 3)), np.empty((count, 3))
    velocity, position = np.zeros((count, 3)), np.zeros((count, 3))
    angle, turn = np.empty((count, 3)), np.empty((3, 3))
    identity_into(rotation[0])
    for k in range(count):
        if k > 0:
            dt = seconds[k] - seconds[k - 1]
            for i in range(3):
                angle[k, i] = (0.5 * (gyro[k, i] + gyro[k - 1, i]) - gyro_bias[i]) * dt
            exp_into(angle[k], turn)
            product_into(rotation[k - 1], turn, rotation[k])
        for i in range(3):
            force[k, i] = 0.0
            for j in range(3):
                force[k, i] += rotation[k, i, j] * (accel[k, j] - accel_bias[j])
        if k > 0:
            for i in range(3):
                f0, f1 = force[k - 1, i], force[k, i]
                velocity[k, i] = velocity[k - 1, i] + 0.5 * (f0 + f1) * dt
                moved = velocity[k - 1, i] * dt + (2.0 * f0 + f1) * dt * dt / 6.0
                position[k, i] = position[k - 1, i] + moved
    jacobian, covariance = np.zeros((9, 6)), np.zeros((9, 9))
    _add_rates(
        *(seconds, angle, rotation, force, velocity, position, gyro_density),
        *(jacobian, covariance),
    )
    _add_forces(seconds, rotation, accel_density, jacobian, covariance)
    return rotation[-1].copy(), velocity[-1].copy(), position[-1].copy(), jacobian, covariance


@compiled
def _add_rates(  # type: ignore[no-untyped-def]
    seconds, angle, rotation, force, velocity, position, density, jacobian, covariance
):
    """Add the effects of an error of the rate in each step, and of its noise."""
    last = len(seconds) - 1
    effect, turn, changed = np.zeros((9, 3)), np.empty((3, 3)), np.empty((3, 3))
    lever, later = np.zeros((9, 3)), np.empty((2, 3))
    for i in range(3):
        for j in range(3):
            lever[i, j] = -rotation[last, j, i]
    for k in range(1, last + 1):
        dt, left = seconds[k] - seconds[k - 1], seconds[last] - seconds[k]
        for i in range(3):  # velocity and position that the forces after this step add
            later[0, i] = velocity[last, i] - velocity[k, i] + 0.5 * force[k, i] * dt
            way = position[last, i] - position[k, i] - velocity[k, i] * left
            later[1, i] = way + force[k, i] * (dt * dt / 6.0 + 0.5 * dt * left)
        for block in range(2):
            x, y, z = later[block, 0], later[block, 1], later[block, 2]
            row = 3 + 3 * block
            lever[row, 1], lever[row, 2], lever[row + 1, 2] = -z, y, -x
            lever[row + 1, 0], lever[row + 2, 0], lever[row + 2, 1] = z, -y, x
        right_jacobian_into(angle[k], turn)
        product_into(rotation[k], turn, changed)
        product_into(lever, changed, effect)
        for i in range(9):
            for j in range(3):
                effect[i, j] *= dt
                jacobian[i, j] += effect[i, j]
        variance = density / dt
        for i in range(9):
            for j in range(9):
                product = effect[i, 0] * effect[j, 0] + effect[i, 1] * effect[j, 1]
                covariance[i, j] += variance * (product + effect[i, 2] * effect[j, 2])


@compiled(**NO_REFCOUNT)
def _add_forces(seconds, rotation, density, jacobian, covariance):  # type: ignore[no-untyped-def]
    """Add the effects of an error of each force, and of its noise, equal in all axes."""
    last = len(seconds) - 1
    for k in range(last + 1):
        in_velocity = in_position = 0.0
        if k > 0:
            dt, left = seconds[k] - seconds[k - 1], seconds[last] - seconds[k]
            in_velocity += 0.5 * dt
            in_position += dt * dt / 6.0 + 0.5 * dt * left
        if k < last:
            dt, left = seconds[k + 1] - seconds[k], seconds[last] - seconds[k + 1]
            in_velocity += 0.5 * dt
            in_position += dt * dt / 3.0 + 0.5 * dt * left
        variance = density / in_velocity
        for i in range(3):
            covariance[3 + i, 3 + i] += variance * in_velocity * in_velocity
            covariance[3 + i, 6 + i] += variance * in_velocity * in_position
            covariance[6 + i, 3 + i] += variance * in_velocity * in_position
            covariance[6 + i, 6 + i] += variance * in_position * in_position
            for j in range(3):
                jacobian[3 + i, 3 + j] -= rotation[k, i, j] * in_velocity
                jacobian[6 + i, 3 + j] -= rotation[k, i, j] * in_position
