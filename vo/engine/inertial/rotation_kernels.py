"""Rotations and derivatives, for compiled loops; `vo.engine.geometry.so3` has them for arrays."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled

_SMALL = 1e-4  # radians below which series are used
_NEAR_PI = 1e-3  # radians from pi, where the antisymmetric part loses the axis


@compiled(**NO_REFCOUNT)
def exp_into(angle, result):  # type: ignore[no-untyped-def]
    """Rotation (3, 3) of a rotation vector (Rodrigues)."""
    squared = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    first, second = 1.0 - squared / 6.0, 0.5 - squared / 24.0
    size = np.sqrt(squared)
    if size >= _SMALL:
        half = np.sin(0.5 * size) / size
        first, second = np.sin(size) / size, 2.0 * half * half
    _series(angle, squared, first, second, result)


@compiled(**NO_REFCOUNT)
def log_into(rotation, result):  # type: ignore[no-untyped-def]
    """Rotation vector of a rotation (3, 3), with an angle in [0, pi]."""
    result[0] = 0.5 * (rotation[2, 1] - rotation[1, 2])
    result[1] = 0.5 * (rotation[0, 2] - rotation[2, 0])
    result[2] = 0.5 * (rotation[1, 0] - rotation[0, 1])
    squared = result[0] * result[0] + result[1] * result[1] + result[2] * result[2]
    sine = np.sqrt(squared)
    cosine = 0.5 * (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if np.pi - angle >= _NEAR_PI:
        ratio = 1.0 + squared / 6.0 if sine < _SMALL else angle / sine
        for i in range(3):
            result[i] *= ratio
        return
    # R + R^T = 2 cos I + 2 (1 - cos) a a^T: the largest column gives the axis.
    largest = 0
    for j in range(1, 3):
        if rotation[j, j] > rotation[largest, largest]:
            largest = j
    size = sign = 0.0
    for i in range(3):
        component = 0.5 * (rotation[i, largest] + rotation[largest, i])
        if i == largest:
            component -= cosine
        size += component * component
        sign += component * result[i]
    factor = (-angle if sign < 0.0 else angle) / np.sqrt(size)
    for i in range(3):
        component = 0.5 * (rotation[i, largest] + rotation[largest, i])
        if i == largest:
            component -= cosine
        result[i] = factor * component


@compiled(**NO_REFCOUNT)
def right_jacobian_into(angle, result):  # type: ignore[no-untyped-def]
    """(3, 3) with exp(v + d) = exp(v) exp(J d) to first order (Forster et al. 2017, eq. 8)."""
    squared = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    first, second = 0.5 - squared / 24.0, 1.0 / 6.0 - squared / 120.0
    size = np.sqrt(squared)
    if size >= _SMALL:
        half = np.sin(0.5 * size) / size
        first, second = 2.0 * half * half, (size - np.sin(size)) / (squared * size)
    _series(angle, squared, -first, second, result)


@compiled(**NO_REFCOUNT)
def inverse_right_jacobian_into(angle, result):  # type: ignore[no-untyped-def]
    """(3, 3) with log(exp(v) exp(d)) = v + J d to first order (Forster et al. 2017, eq. 9)."""
    squared = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    second = 1.0 / 12.0 + squared / 720.0
    size = np.sqrt(squared)
    if size >= _SMALL:
        second = (1.0 - 0.5 * size / np.tan(0.5 * size)) / squared
    _series(angle, squared, 0.5, second, result)


@compiled(**NO_REFCOUNT)
def _series(v, squared, first, second, result):  # type: ignore[no-untyped-def]
    """I + first K + second K² of the cross product K with a vector; K² = v v^T - |v|² I."""
    for i in range(3):
        for j in range(3):
            result[i, j] = second * v[i] * v[j]
        result[i, i] += 1.0 - second * squared
    result[0, 1] -= first * v[2]
    result[1, 0] += first * v[2]
    result[0, 2] += first * v[1]
    result[2, 0] -= first * v[1]
    result[1, 2] -= first * v[0]
    result[2, 1] += first * v[0]


@compiled(**NO_REFCOUNT)
def identity_into(result):  # type: ignore[no-untyped-def]
    """The identity (3, 3)."""
    for i in range(3):
        for j in range(3):
            result[i, j] = 0.0
        result[i, i] = 1.0


@compiled(**NO_REFCOUNT)
def product_into(a, b, result):  # type: ignore[no-untyped-def]
    """Product of (n, 3) and (3, 3) in `result` (n, 3)."""
    for i in range(len(a)):
        for j in range(3):
            result[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled(**NO_REFCOUNT)
def transposed_product_into(a, b, result):  # type: ignore[no-untyped-def]
    """Product of the transpose of `a` (3, 3) with `b` (3, 3)."""
    for i in range(3):
        for j in range(3):
            result[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]
