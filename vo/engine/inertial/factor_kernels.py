"""Residuals of neighbouring states, their derivatives and normal equations, as compiled loops."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.engine.inertial.rotation_kernels import (
    exp_into,
    inverse_right_jacobian_into,
    log_into,
    product_into,
    right_jacobian_into,
    transposed_product_into,
)

# Columns of the tangent of a state, as in `states.py`.
_ROTATION, _POSITION, _VELOCITY, _GYRO, _ACCEL, _LOG_SCALE = 0, 3, 6, 9, 12, 15
_WIDTH = 16


@compiled
def inertial_factors(  # type: ignore[no-untyped-def]
    before, after, gyro_bias, accel_bias, duration, turn, moved, jacobian, at_gyro, at_accel, down
):
    """Residuals (n, 9), and their derivatives (n, 9, _WIDTH) by the states at both ends.

    Args:
        before: rotations (n, 3, 3), positions (n, 3) and velocities (n, 3).
        after: the same, later.
        gyro_bias: (n, 3) before.
        accel_bias: (n, 3) before.
        duration: (n,) s.
        turn: (n, 3, 3) measured.
        moved: (n, 6) measured velocity and position.
        jacobian: (n, 9, 6) of the measured motion by both biases.
        at_gyro: (n, 3) bias that was subtracted.
        at_accel: (n, 3) the same.
        down: gravity along z, m/s².
    """
    rotation0, position0, velocity0 = before
    rotation1, position1, velocity1 = after
    count = len(duration)
    residual = np.empty((count, 9))
    first, second = np.zeros((count, 9, _WIDTH)), np.zeros((count, 9, _WIDTH))
    change, angle, vector = np.empty(9), np.empty(3), np.empty((2, 3))
    measured, relative, off = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    unturned, of_bias = np.empty((3, 3)), np.empty((3, 3))
    for k in range(count):
        dt = duration[k]
        for i in range(9):
            change[i] = 0.0
            for j in range(3):
                change[i] += jacobian[k, i, j] * (gyro_bias[k, j] - at_gyro[k, j])
                change[i] += jacobian[k, i, 3 + j] * (accel_bias[k, j] - at_accel[k, j])
        exp_into(change, off)
        product_into(turn[k], off, measured)
        transposed_product_into(rotation0[k], rotation1[k], relative)
        transposed_product_into(measured, relative, off)
        log_into(off, angle)
        for i in range(3):
            fall = down * dt if i == 2 else 0.0
            vector[0, i] = velocity1[k, i] - velocity0[k, i] - fall
            vector[1, i] = position1[k, i] - position0[k, i] - velocity0[k, i] * dt
            vector[1, i] -= 0.5 * fall * dt
        product_into(vector, rotation0[k], off[:2])
        for i in range(3):
            residual[k, i] = angle[i]
            residual[k, 3 + i] = off[0, i] - moved[k, i] - change[3 + i]
            residual[k, 6 + i] = off[1, i] - moved[k, 3 + i] - change[6 + i]
        _set_skew(first[k], 3, off[0])
        _set_skew(first[k], 6, off[1])
        inverse_right_jacobian_into(angle, unturned)
        right_jacobian_into(change, measured)
        transposed_product_into(unturned, measured, of_bias)  # that of -angle is its transpose
        for i in range(3):
            for j in range(3):
                second[k, i, _ROTATION + j] = unturned[i, j]
                for m in range(3):
                    first[k, i, _ROTATION + j] -= unturned[i, m] * relative[j, m]
                    first[k, i, _GYRO + j] -= of_bias[i, m] * jacobian[k, m, j]
                back = rotation0[k, j, i]
                first[k, 3 + i, _VELOCITY + j], second[k, 3 + i, _VELOCITY + j] = -back, back
                first[k, 6 + i, _VELOCITY + j] = -back * dt
                first[k, 6 + i, _POSITION + j], second[k, 6 + i, _POSITION + j] = -back, back
        for i in range(3, 9):
            for j in range(3):
                first[k, i, _GYRO + j] = -jacobian[k, i, j]
                first[k, i, _ACCEL + j] = -jacobian[k, i, 3 + j]
    return residual, first, second


@compiled
def visual_factors(  # type: ignore[no-untyped-def]
    rotation0, position0, log_scale, rotation1, position1, visual, to_imu, lever
):
    """Residuals (n, 6), and their derivatives (n, 6, _WIDTH) by the states at both ends.

    Args:
        rotation0: (n, 3, 3) before.
        position0: (n, 3) before.
        log_scale: (n,) before.
        rotation1: (n, 3, 3) after.
        position1: (n, 3) after.
        visual: (n, 4, 4) as in `visual_residuals`.
        to_imu: (3, 3) rotation of imu_from_cam.
        lever: (3,) its translation.
    """
    count = len(visual)
    residual = np.empty((count, 6))
    first, second = np.zeros((count, 6, _WIDTH)), np.zeros((count, 6, _WIDTH))
    angle, way, arm = np.empty(3), np.empty((1, 3)), np.empty((1, 3))
    cam0, cam1, relative = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    turned, back, to_after = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    arms = np.zeros((3, 3, 3))  # of the position, of the lever, and products
    for k in range(count):
        units = np.exp(-log_scale[k])  # of the map, of one metre
        product_into(rotation0[k], to_imu, cam0)
        product_into(rotation1[k], to_imu, cam1)
        transposed_product_into(cam0, cam1, relative)
        transposed_product_into(visual[k], relative, turned)
        log_into(turned, angle)
        inverse_right_jacobian_into(angle, turned)
        for i in range(3):
            way[0, i] = position1[k, i] - position0[k, i]
            for j in range(3):
                way[0, i] += (rotation1[k, i, j] - rotation0[k, i, j]) * lever[j]
                back[i, j] = visual[k, j, i]
        product_into(way, rotation0[k], arm)
        for i in range(3):
            arm[0, i] += lever[i]
        _set_skew(arms[0], 0, arm[0])
        _set_skew(arms[1], 0, lever)
        product_into(way, cam0, arm)
        for i in range(3):
            residual[k, i], residual[k, 3 + i] = angle[i], 0.0
            for j in range(3):
                moved = units * arm[0, j]
                residual[k, 3 + i] += back[i, j] * (moved - visual[k, j, 3])
                first[k, 3 + i, _LOG_SCALE] -= back[i, j] * moved
                to_after[i, j] = 0.0
                for m in range(3):
                    to_after[i, j] += units * back[i, m] * cam0[j, m]
        product_into(rotation1[k], arms[1], arms[2])
        transposed_product_into(cam1, rotation0[k], relative)
        for i in range(3):
            for j in range(3):
                first[k, 3 + i, _POSITION + j] = -to_after[i, j]
                second[k, 3 + i, _POSITION + j] = to_after[i, j]
                for m in range(3):
                    first[k, i, _ROTATION + j] -= turned[i, m] * relative[m, j]
                    second[k, i, _ROTATION + j] += turned[i, m] * to_imu[j, m]
                    second[k, 3 + i, _ROTATION + j] -= to_after[i, m] * arms[2, m, j]
                    in_imu = 0.0
                    for n in range(3):
                        in_imu += back[i, n] * to_imu[m, n]
                    first[k, 3 + i, _ROTATION + j] += units * in_imu * arms[0, m, j]
    return residual, first, second


@compiled
def add_factors(  # type: ignore[no-untyped-def]
    rows, residual, first, second, information, huber, equations
):
    """Add factors between the states of some rows and the next ones to their equations.

    Args:
        rows: (n,).
        residual: (n, m).
        first: (n, m, d) derivatives by the earlier state.
        second: (n, m, d) by the later one.
        information: (n, m, m).
        huber: normalised size of a residual from which it counts less.
        equations: the fields of `Equations`.

    Returns:
        Sum of the squared normalised residuals.
    """
    before, after, coupling, gradient_before, gradient_after = equations
    size, width = residual.shape[1], first.shape[2]
    weighted = np.empty((2, width, size))
    total = 0.0
    for k in range(len(rows)):
        row, squared = rows[k], 0.0
        for i in range(size):
            for j in range(size):
                squared += residual[k, i] * information[k, i, j] * residual[k, j]
        squared = max(squared, 0.0)
        total += squared
        off, weight = np.sqrt(squared / size), 1.0
        if off > huber:
            weight = huber / off
        for a in range(width):
            for j in range(size):
                weighted[0, a, j] = weighted[1, a, j] = 0.0
                for i in range(size):
                    weighted[0, a, j] += first[k, i, a] * weight * information[k, i, j]
                    weighted[1, a, j] += second[k, i, a] * weight * information[k, i, j]
        for a in range(width):
            for i in range(size):
                left, right = weighted[0, a, i], weighted[1, a, i]
                gradient_after[row, a] += left * residual[k, i]
                gradient_before[row + 1, a] += right * residual[k, i]
                for b in range(width):
                    after[row, a, b] += left * first[k, i, b]
                    before[row + 1, a, b] += right * second[k, i, b]
                    coupling[row, a, b] += left * second[k, i, b]
    return total


@compiled
def add_changes(rows, column, weight, change, equations):  # type: ignore[no-untyped-def]
    """Add the cost of a change (n, c) of some columns to the next state, with weights (n, c)."""
    before, after, coupling, gradient_before, gradient_after = equations
    for k in range(len(rows)):
        row = rows[k]
        for j in range(change.shape[1]):
            c, w = column + j, weight[k, j]
            after[row, c, c] += w
            before[row + 1, c, c] += w
            coupling[row, c, c] -= w
            gradient_after[row, c] -= w * change[k, j]
            gradient_before[row + 1, c] += w * change[k, j]


@compiled(**NO_REFCOUNT)
def _set_skew(matrix, row, v):  # type: ignore[no-untyped-def]
    """Set three rows from a given one on, in the first columns, to the cross product with `v`."""
    matrix[row, 1], matrix[row, 2] = -v[2], v[1]
    matrix[row + 1, 0], matrix[row + 1, 2] = v[2], -v[0]
    matrix[row + 2, 0], matrix[row + 2, 1] = -v[1], v[0]
