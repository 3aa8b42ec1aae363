"""What a window says of its poses, all else eliminated, with errors that last.

The errors of aligned patches are small but not independent. A patch looks a little different from
every new side, so that the place found for it creeps from keyframe to keyframe; its disparity is
off by about the same everywhere. Taken for independent they would average out over a long track,
and did not: see docs/accuracy.md for the autocorrelation of residuals that this model is drawn
from.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from vo.smoothing.linearisation import Linearised
from vo.types import Floats

_SINGULAR = 1e-13  # pivot of a point's normal matrix, against its trace, below which it is dropped
_LEAST_OBSERVATIONS = 3  # below that a pose cannot be determined


class ErrorModel(NamedTuple):
    """Standard deviations of measurements, against those that the window weighs with.

    Attributes:
        white: of a position, by itself in each keyframe.
        creep: of a position, added from one keyframe to the next.
        disparity: of a disparity, by itself in each keyframe.
        disparity_bias: of a disparity, the same in all keyframes.
    """

    white: float
    creep: float
    disparity: float
    disparity_bias: float


OF_PATCHES = ErrorModel(white=0.1, creep=0.2, disparity=0.25, disparity_bias=0.25)


def pose_information(linear: Linearised, scale: float, model: ErrorModel = OF_PATCHES) -> Floats:
    """(6 K, 6 K) information on K poses, for covariances `scale` times those of the model.

    Points are eliminated by the Schur complement. 0 for poses with too few observations.

    Source: Triggs et al., "Bundle Adjustment", 2000, sec. 6.1; of correlated observations
    generalised least squares (Aitken 1935).
    """
    information = _eliminated(
        linear.poses,
        linear.starts,
        linear.keyframe,
        linear.by_pose,
        linear.by_point,
        *(sigma**2 for sigma in model),
    )
    unknown = np.repeat(linear.seen < _LEAST_OBSERVATIONS, 6)
    information[unknown] = 0.0
    information[:, unknown] = 0.0
    return np.asarray(information / scale)


@numba.njit(cache=True, nogil=True)
def _eliminated(  # type: ignore[no-untyped-def]
    poses, starts, keyframe, by_pose, by_point, white, creep, disparity, bias
):
    # By blocks of 6 x 6, those on and above the diagonal: a block's rows lie side by side.
    blocks = np.zeros((poses, poses, 6, 6))
    most = 0
    for m in range(len(starts) - 1):
        most = max(most, starts[m + 1] - starts[m])
    weight, weight_d = np.zeros((most, most)), np.zeros((most, most))
    lifted = np.zeros((most, 3, 3))
    coupling, solved = np.zeros((most, 3, 6)), np.zeros((most, 3, 6))
    normal, inverse = np.zeros((3, 3)), np.zeros((3, 3))
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        if last - first < 2:
            continue
        at, pose, point = keyframe[first:last], by_pose[first:last], by_point[first:last]
        _position_weights(at, white, creep, weight)
        _disparity_weights(point, disparity, bias, weight_d)
        _add_point_normal(point, weight, weight_d, lifted, normal)
        if _invert(normal, inverse):
            _couple(pose, lifted, inverse, coupling, solved)
            _add_point(at, pose, weight, weight_d, coupling, solved, blocks)
    information = np.zeros((6 * poses, 6 * poses))
    for r in range(6 * poses):
        for c in range(r, 6 * poses):
            information[r, c] = information[c, r] = blocks[r // 6, c // 6, r % 6, c % 6]
    return information


@numba.njit(cache=True, nogil=True)
def _position_weights(at, white, creep, weight):  # type: ignore[no-untyped-def]
    """Inverse of white I + creep (keyframes since the first, of the earlier one), in place."""
    n = len(at)
    for a in range(n):
        for b in range(n):
            weight[a, b] = creep * (min(at[a], at[b]) - at[0])
        weight[a, a] += white
    for k in range(n):  # Gauss-Jordan: positive definite, no pivots needed
        pivot = 1.0 / weight[k, k]
        weight[k, k] = 1.0
        for c in range(n):
            weight[k, c] *= pivot
        for r in range(n):
            if r != k:
                factor = weight[r, k]
                weight[r, k] = 0.0
                for c in range(n):
                    weight[r, c] -= factor * weight[k, c]


@numba.njit(cache=True, nogil=True)
def _disparity_weights(point, disparity, bias, weight):  # type: ignore[no-untyped-def]
    """Inverse of disparity I + bias 1 1^T over those that were measured (Sherman-Morrison)."""
    n, measured = len(point), 0
    for a in range(n):
        measured += _is_measured(point, a)
    shared = bias / (disparity * (disparity + measured * bias))
    for a in range(n):
        for b in range(n):
            both = _is_measured(point, a) and _is_measured(point, b)
            own = 1.0 / disparity if a == b else 0.0
            weight[a, b] = own - shared if both else 0.0


@numba.njit(cache=True, nogil=True)
def _is_measured(point, a):  # type: ignore[no-untyped-def]
    return point[a, 2, 0] != 0.0 or point[a, 2, 1] != 0.0 or point[a, 2, 2] != 0.0


@numba.njit(cache=True, nogil=True)
def _add_point_normal(point, weight, weight_d, lifted, normal):  # type: ignore[no-untyped-def]
    """Fill `lifted`, the weights times the derivatives by the point, and their square."""
    n = len(point)
    normal[:] = 0.0
    for a in range(n):
        for r in range(3):
            for p in range(3):
                total = 0.0
                for b in range(n):
                    total += (weight_d[a, b] if r == 2 else weight[a, b]) * point[b, r, p]
                lifted[a, r, p] = total
            for p in range(3):
                for q in range(3):
                    normal[p, q] += point[a, r, p] * lifted[a, r, q]


@numba.njit(cache=True, nogil=True)
def _invert(m, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric (3, 3) by cofactors; False if it is singular."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    determinant = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if not determinant > _SINGULAR * trace * trace * trace:
        return False
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = c00, c01, c02
    inverse[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    inverse[1, 2] = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    inverse[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    for p in range(3):
        for q in range(p, 3):
            inverse[p, q] /= determinant
            inverse[q, p] = inverse[p, q]
    return True


@numba.njit(cache=True, nogil=True)
def _couple(pose, lifted, inverse, coupling, solved):  # type: ignore[no-untyped-def]
    """Fill how each observation ties a point to its pose, and that times the point's covariance."""
    for a in range(len(pose)):
        for p in range(3):
            u, v, w = lifted[a, 0, p], lifted[a, 1, p], lifted[a, 2, p]
            for c in range(6):
                coupling[a, p, c] = u * pose[a, 0, c] + v * pose[a, 1, c] + w * pose[a, 2, c]
        own = coupling[a]
        for p in range(3):
            u, v, w = inverse[p, 0], inverse[p, 1], inverse[p, 2]
            for c in range(6):
                solved[a, p, c] = u * own[0, c] + v * own[1, c] + w * own[2, c]


@numba.njit(cache=True, nogil=True)
def _add_point(at, pose, weight, weight_d, coupling, solved, blocks):  # type: ignore[no-untyped-def]
    """What the observations of one point say of their poses, the point eliminated."""
    for a in range(len(at)):
        mine, gain = pose[a], solved[a]
        for b in range(a, len(at)):
            block, other, tie = blocks[at[a], at[b]], pose[b], coupling[b]
            own, own_d = weight[a, b], weight_d[a, b]
            for c in range(6):
                u, v, w = own * mine[0, c], own * mine[1, c], own_d * mine[2, c]
                i, j, k = gain[0, c], gain[1, c], gain[2, c]
                for d in range(6):
                    block[c, d] += u * other[0, d] + v * other[1, d] + w * other[2, d]
                    block[c, d] -= i * tie[0, d] + j * tie[1, d] + k * tie[2, d]
