"""Rotations SO(3) as arrays of matrices (..., 3, 3), and their tangent vectors in radians."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.transforms import skew
from vo.base.types import Floats

_SMALL = 1e-4  # radians below which series are used
_NEAR_PI = 1e-3  # radians from pi, where the antisymmetric part loses the axis


def exp(rotvec: Floats) -> Floats:
    """Rotations (..., 3, 3) of rotation vectors (..., 3) (Rodrigues)."""
    squared = np.sum(rotvec * rotvec, axis=-1)[..., None, None]
    angle = np.sqrt(squared)
    safe = np.where(angle < _SMALL, 1.0, angle)
    first = np.where(angle < _SMALL, 1.0 - squared / 6.0, np.sin(safe) / safe)
    half = np.sin(0.5 * safe) / safe
    second = np.where(angle < _SMALL, 0.5 - squared / 24.0, 2.0 * half * half)
    k = skew(rotvec)
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def log(rotation: Floats) -> Floats:
    """Rotation vectors (..., 3) of rotations (..., 3, 3), with angles in [0, pi]."""
    antisymmetric = 0.5 * np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(antisymmetric, axis=-1)
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    small = sine < _SMALL
    ratio = np.where(small, 1.0 + sine * sine / 6.0, angle / np.where(small, 1.0, sine))
    result = antisymmetric * ratio[..., None]
    opposite = np.pi - angle < _NEAR_PI
    if np.any(opposite):
        # R + R^T = 2 cos I + 2 (1 - cos) a a^T: the largest column gives the axis.
        symmetric = 0.5 * (rotation + np.swapaxes(rotation, -1, -2))
        outer = symmetric - cosine[..., None, None] * np.eye(3)
        largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
        column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
        axis = column / np.maximum(np.linalg.norm(column, axis=-1, keepdims=True), 1e-300)
        sign = np.where(np.sum(axis * antisymmetric, axis=-1, keepdims=True) < 0, -1.0, 1.0)
        result = np.where(opposite[..., None], sign * axis * angle[..., None], result)
    return np.asarray(result)


def right_jacobian(rotvec: Floats) -> Floats:
    """(..., 3, 3) with exp(v + d) = exp(v) exp(J d) to first order.

    Source: Forster et al. 2017, eq. 8.
    """
    squared = np.sum(rotvec * rotvec, axis=-1)[..., None, None]
    angle = np.sqrt(squared)
    safe = np.where(angle < _SMALL, 1.0, angle)
    half = np.sin(0.5 * safe) / safe
    first = np.where(angle < _SMALL, 0.5 - squared / 24.0, 2.0 * half * half)
    second = np.where(angle < _SMALL, 1.0 / 6.0 - squared / 120.0, (safe - np.sin(safe)) / safe**3)
    k = skew(rotvec)
    return np.asarray(np.eye(3) - first * k + second * (k @ k))


def inverse_right_jacobian(rotvec: Floats) -> Floats:
    """(..., 3, 3) with log(exp(v) exp(d)) = v + J d to first order, for angles below pi.

    Source: Forster et al. 2017, eq. 9.
    """
    squared = np.sum(rotvec * rotvec, axis=-1)[..., None, None]
    angle = np.sqrt(squared)
    safe = np.where(angle < _SMALL, 1.0, angle)
    # 1/a^2 - (1 + cos a) / (2 a sin a) = (1 - (a/2) cot(a/2)) / a^2
    second = np.where(
        angle < _SMALL,
        1.0 / 12.0 + squared / 720.0,
        (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / (safe * safe),
    )
    k = skew(rotvec)
    return np.asarray(np.eye(3) + 0.5 * k + second * (k @ k))


def running_products(factors: Floats) -> Floats:
    """Products (n + 1, 3, 3) of the first 0, 1, ... n rotations (n, 3, 3), in this order.

    Source: Hillis and Steele, "Data parallel algorithms", 1986 (doubling).
    """
    products = factors.copy()
    step = 1
    while step < len(products):
        products[step:] = products[:-step] @ products[step:]
        step *= 2
    return np.concatenate([np.eye(3)[None], products])


_SMALL_ROWS = 1e-8


def exp_rows(rotvec: Floats) -> Floats:
    """Rotation matrices (N, 3, 3) of rotation vectors (N, 3)."""
    angle = np.linalg.norm(rotvec, axis=1)[:, None, None]
    k = skew(rotvec)
    safe = np.maximum(angle, _SMALL_ROWS)
    first = np.where(angle < _SMALL_ROWS, 1.0, np.sin(safe) / safe)
    second = np.where(angle < _SMALL_ROWS, 0.5, (1.0 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + first * k + second * (k @ k))


def log_rows(rotation: Floats) -> Floats:
    """Rotation vectors (N, 3) of rotation matrices (N, 3, 3), for angles below 179 degrees."""
    cosine = np.clip(0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1.0), -1.0, 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    factor = np.where(angle < 1e-4, 0.5 + angle**2 / 12.0, 0.5 * angle / np.maximum(sine, 1e-12))
    vee = np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )
    return np.asarray(factor[:, None] * vee)
