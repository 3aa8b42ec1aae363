"""The drift of a map's scale, as the covariances of its motions state it.

In the map of one camera the motions of all keyframes have one error of the scale in common, which
grows where the images hardly determine lengths. Each covariance contains the whole of it; taken for
an error of its own of each motion it would hide how well their lengths agree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Floats
from vo.engine.inertial.chain_solver import invert_into
from vo.engine.inertial.states import Steps

_KEPT = 1e-3  # of the common error, so that covariances keep an inverse


class ScaleDrift(NamedTuple):
    """Errors of n motions, with that of the scale apart."""

    covariance: Floats  # (n, 6, 6) of the motions at the scale of the map there, as in `Steps`
    # (n,) variance by which the logarithm of the scale differs after each of them
    log_scale: Floats


def without_scale(steps: Steps) -> ScaleDrift:
    """Take the common error of the scale out of the covariances of a map of one camera.

    The covariance C of a motion d is v d dᵀ + E, with the variance v of the logarithm of the scale
    and its own errors E. v is at most c = 1 / (dᵀ C⁻¹ d), of this motion and of all later ones,
    since the scale drifts and does not come back. Assumed is that E is as large along the motion
    as across it; then v is at least c less that.
    """
    found = _without_scale(
        np.ascontiguousarray(steps.visual),
        np.ascontiguousarray(steps.covariance),
        np.ascontiguousarray(steps.is_visual),
    )
    return ScaleDrift(*found)


@compiled
def _without_scale(visual, covariance, is_visual):  # type: ignore[no-untyped-def]
    count = len(visual)
    along, variance, most = np.zeros((count, 3)), np.zeros(count), np.full(count, np.inf)
    result, drift = covariance.copy(), np.zeros(count)
    matrix, lower, inverse = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    scale, unit, across = np.empty(6), np.empty(3), np.empty((3, 3))
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
        most[n] = 1.0 / informed
        errors = _largest_across(covariance[n], unit, across)
        variance[n] = max(0.0, most[n] - errors / squared)  # the least
    for n in range(1, count):
        if is_visual[n] and is_visual[n - 1]:
            variance[n] = max(variance[n], variance[n - 1])
    for n in range(count - 1, -1, -1):
        if n + 1 < count and is_visual[n] and is_visual[n + 1]:
            most[n] = min(most[n], most[n + 1])
        variance[n] = min(variance[n], most[n])
    for n in range(count):
        common = (1.0 - _KEPT) * variance[n]
        for i in range(3):
            for j in range(3):
                result[n, 3 + i, 3 + j] -= common * along[n, i] * along[n, j]
        if n + 1 < count and is_visual[n] and is_visual[n + 1]:
            drift[n] = max(variance[n + 1] - variance[n], 0.0)
    return result, drift


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
