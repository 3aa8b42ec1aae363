"""Sampson distances of matched pixels from a fundamental matrix or a homography.

It is, to first order, how far the two pixels of a match together must be moved to satisfy the
model.
"""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats
from vo.engine.geometry import epipolar


def sampson(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Signed Sampson distances (N,) in px of pixels (N, 2) in two views from a fundamental matrix.

    Source: Luong and Faugeras, "The fundamental matrix", 1996; Hartley and Zisserman, eq. 11.9.
    """
    a = np.column_stack([first, np.ones(len(first))])
    b = np.column_stack([second, np.ones(len(second))])
    line_b, line_a = a @ fundamental.T, b @ fundamental
    squared = (line_a[:, :2] ** 2).sum(axis=1) + (line_b[:, :2] ** 2).sum(axis=1)
    return np.asarray((b * line_b).sum(axis=1) / np.sqrt(np.maximum(squared, 1e-30)))


def line_errors(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Sampson distances (N,) in px from a fundamental matrix."""
    return np.abs(sampson(fundamental, first, second))


def point_errors(homography: Floats, first: Floats, second: Floats) -> Floats:
    """Sampson distances of a homography, where it maps lengths alike in all directions."""
    try:
        in_second, in_first = epipolar.transfer_errors(homography, first, second)
    except np.linalg.LinAlgError:
        return np.full(len(first), np.inf)
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt(1.0 / in_second + 1.0 / in_first))
