"""The drift of a map's scale, as the covariances of its motions state it.

In the map of one camera the motions of all keyframes have one error of the scale in common, which
grows where the images hardly determine lengths. Each covariance contains the whole of it; taken for
an error of its own of each motion it would hide how well their lengths agree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.inertial.states import Steps
from vo.types import Bools, Floats

_KEPT = 1e-3  # of the common error, so that covariances keep an inverse


class ScaleDrift(NamedTuple):
    """Errors of n motions, with that of the scale apart.

    Attributes:
        covariance: (n, 6, 6) of the motions at the scale of the map there, as in `Steps`.
        log_scale: (n,) variance by which the logarithm of the scale differs after each of them.
    """

    covariance: Floats
    log_scale: Floats


def without_scale(steps: Steps) -> ScaleDrift:
    """Take the common error of the scale out of the covariances of a map of one camera.

    The covariance C of a motion d is v d dᵀ + E, with the variance v of the logarithm of the scale
    and its own errors E. v is at most c = 1 / (dᵀ C⁻¹ d), of this motion and of all later ones,
    since the scale drifts and does not come back. Assumed is that E is as large along the motion
    as across it; then v is at least c less that.
    """
    along = np.zeros((len(steps.covariance), 6))
    along[:, 3:] = np.einsum("nji,nj->ni", steps.visual[:, :3, :3], steps.visual[:, :3, 3])
    most, least = _bounds(along, steps.covariance, steps.is_visual)
    variance = np.zeros(len(along))
    # A motion between two segments has no covariance, and separates two scales.
    for rows in np.split(np.arange(len(along)), np.flatnonzero(~steps.is_visual)):
        inner = rows[steps.is_visual[rows]]
        upper = np.minimum.accumulate(most[inner][::-1])[::-1]
        variance[inner] = np.minimum(upper, np.maximum.accumulate(least[inner]))
    common = (1.0 - _KEPT) * variance[:, None, None] * along[:, :, None] * along[:, None, :]
    drift = np.zeros(len(along))
    joined = steps.is_visual[1:] & steps.is_visual[:-1]
    drift[:-1] = np.where(joined, np.maximum(np.diff(variance), 0.0), 0.0)
    return ScaleDrift(steps.covariance - common, drift)


def _bounds(along: Floats, covariance: Floats, is_visual: Bools) -> tuple[Floats, Floats]:
    """Largest and least variance (n,) of the logarithm of the scale by each motion alone."""
    most, least = np.full(len(along), np.inf), np.zeros(len(along))
    squared = (along**2).sum(axis=1)
    known = is_visual & (np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2) > 0.0)
    known &= squared > 1e-20
    rows = np.flatnonzero(known)
    direction, inner = along[rows], covariance[rows]
    informed = np.linalg.solve(inner, direction[:, :, None])[:, :, 0]
    most[rows] = 1.0 / (direction * informed).sum(axis=1)
    unit = direction[:, 3:] / np.sqrt(squared[rows, None])
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    errors = np.linalg.eigvalsh(across @ inner[:, 3:, 3:] @ across)[:, -1]
    least[rows] = np.maximum(0.0, most[rows] - errors / squared[rows])
    return most, least
