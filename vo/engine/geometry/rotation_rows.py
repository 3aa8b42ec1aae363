"""Exponential and logarithm of many rotations at once."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats

_SMALL = 1e-8


def exp_rows(rotvec: Floats) -> Floats:
    """Rotation matrices (N, 3, 3) of rotation vectors (N, 3)."""
    angle = np.linalg.norm(rotvec, axis=1)[:, None, None]
    k = skew_rows(rotvec)
    safe = np.maximum(angle, _SMALL)
    first = np.where(angle < _SMALL, 1.0, np.sin(safe) / safe)
    second = np.where(angle < _SMALL, 0.5, (1.0 - np.cos(safe)) / safe**2)
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


def skew_rows(vectors: Floats) -> Floats:
    """Matrices (N, 3, 3) of the cross product with vectors (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
