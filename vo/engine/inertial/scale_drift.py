"""The common error of a map's scale, taken out of the covariances of its motions."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Floats
from vo.engine.inertial.chain_solver import invert_into
from vo.engine.inertial.states import Steps

_KEPT = 1e-3  # of the common error, so that covariances keep an inverse
_NEAR = 4  # motions on either side whose median the common error is at most


def without_scale(steps: Steps) -> Floats:
    """Covariances (n, 6, 6) of a map of one camera without the common error of the scale.

    The covariance C of a motion d is v d dᵀ + E, with the variance v of the logarithm of the scale
    and its own errors E. Assumed is that E is as large along the motion as across it; with
    c = 1 / (dᵀ C⁻¹ d), v is then c less that. It is at most the median of v around, since an error
    that a few motions have alone is their own.
    """
    fields = steps.visual, steps.covariance, steps.is_visual
    found = _without_scale(*(np.ascontiguousarray(field) for field in fields))
    return np.asarray(found, np.float64)


@compiled
def _without_scale(visual, covariance, is_visual):  # type: ignore[no-untyped-def]
    count = len(visual)
    along, variance, result = np.zeros((count, 3)), np.zeros(count), covariance.copy()
    matrix, lower, inverse = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    scale, unit, across = np.empty(6), np.empty(3), np.empty((3, 3))
    near = np.empty(2 * _NEAR + 1)
    for n in range(count):
        squared = trace = 0.0
        for i in range(3):
            for j in range(3):
                along[n, i] += visual[n, j, i] * visual[n, j, 3]
            squared += along[n, i] * along[n, i]
            trace += covariance[n, 3 + i, 3 + i]
        # A motion between two segments has no covariance, and separates two scales.
        if not is_visual[n] or not trace > 0.0 or squared <= 1e-20:
            continue
        for i in range(6):
            for j in range(6):
                matrix[i, j] = covariance[n, i, j]
        if not invert_into(matrix, scale, lower, inverse):
            continue
        informed = 0.0
        for i in range(3):
            unit[i] = along[n, i] / np.sqrt(squared)
            for j in range(3):
                informed += along[n, i] * inverse[3 + i, 3 + j] * along[n, j]
        errors = _largest_across(covariance[n], unit, across)
        variance[n] = max(0.0, 1.0 / informed - errors / squared)
    for n in range(count):
        if not is_visual[n]:
            continue
        first, end = n, n + 1
        while first > 0 and first > n - _NEAR and is_visual[first - 1]:
            first -= 1
        while end < count and end <= n + _NEAR and is_visual[end]:
            end += 1
        common = (1.0 - _KEPT) * min(variance[n], 4.0 * _median(variance[first:end], near))
        for i in range(3):
            for j in range(3):
                result[n, 3 + i, 3 + j] -= common * along[n, i] * along[n, j]
    return result


@compiled(**NO_REFCOUNT)
def _median(values, ordered):  # type: ignore[no-untyped-def]
    """Median of a few values; `np.median` takes half as long to compile as all the rest here."""
    count = len(values)
    for n in range(count):
        k = n
        while k > 0 and ordered[k - 1] > values[n]:
            ordered[k] = ordered[k - 1]
            k -= 1
        ordered[k] = values[n]
    return (ordered[(count - 1) // 2] + ordered[count // 2]) / 2.0


@compiled(**NO_REFCOUNT)
def _largest_across(covariance, unit, across):  # type: ignore[no-untyped-def]
    """Largest eigenvalue of the covariance of a position, across a direction."""
    for i in range(3):
        for j in range(3):
            across[i, j] = 0.0
            for a in range(3):
                left = (1.0 if i == a else 0.0) - unit[i] * unit[a]
                for b in range(3):
                    right = (1.0 if j == b else 0.0) - unit[j] * unit[b]
                    across[i, j] += left * covariance[3 + a, 3 + b] * right
    # The third eigenvalue is 0.
    half = 0.5 * (across[0, 0] + across[1, 1] + across[2, 2])
    product = across[0, 0] * across[1, 1] - across[0, 1] * across[1, 0]
    product += across[0, 0] * across[2, 2] - across[0, 2] * across[2, 0]
    product += across[1, 1] * across[2, 2] - across[1, 2] * across[2, 1]
    return half + np.sqrt(max(half * half - product, 0.0))
