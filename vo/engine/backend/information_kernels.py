"""Compiled elimination of points whose errors are correlated, see `information`.

The layout is that of `block_kernels`.
"""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, Intrinsic, compiled
from vo.engine.backend.block_kernels import cofactors_of, divide
from vo.engine.backend.block_matrix import BLOCK, LANES
from vo.engine.geometry.points import SINGULAR

# Sizes of a Jacobian by a pose, and of one by a point.
_ROWS, _POINT = 3 * LANES, 9

_set_product = Intrinsic("vo.engine.backend.intrinsics", "set_product")
_add_product = Intrinsic("vo.engine.backend.intrinsics", "add_product")
_subtract_product = Intrinsic("vo.engine.backend.intrinsics", "subtract_product")


@compiled(fastmath={"contract"})
def eliminated(  # type: ignore[no-untyped-def]
    row, place, starts, keyframe, by_pose, by_point, wanted, white, creep, disparity, bias
):
    """Blocks of the information of K poses, points eliminated; see `information.pose_information`.

    The errors of one point are correlated: with weight matrices W (n, n) of its pixels and D (n, n)
    of its disparities, products A^T A become sums of A_a^T W_ab A_b over pairs of observations.
    `lifted` holds W B, `coupling` B^T W A, and `solved` (B^T W B)^-1 B^T W A. `place`: (K,) rows of
    the poses in the matrix, `row`: as of `reduced_blocks`. Blocks of two poses that are not
    `wanted` (K,) are left out.
    """
    blocks = np.zeros((row[-1] + len(row)) * BLOCK)
    max_views = 0
    for m in range(len(starts) - 1):
        max_views = max(max_views, starts[m + 1] - starts[m])
    own_weight, weight_d = np.zeros((max_views, max_views)), np.zeros((max_views, max_views))
    # Most points are seen by consecutive keyframes: weights of n of them are computed once.
    usual, is_known = np.zeros((max_views + 1, max_views, max_views)), np.zeros(max_views + 1)
    lifted, pose, weighted = (
        np.zeros(max_views * _POINT),
        np.zeros(max_views * _ROWS),
        np.zeros(_ROWS),
    )
    coupling, solved = np.zeros(max_views * _ROWS), np.zeros(max_views * _ROWS)
    to = np.zeros(max_views, dtype=np.int64)
    normal, inverse = np.zeros((3, 3)), np.zeros((3, 3))
    flat_inverse = inverse.reshape(-1)
    for m in range(len(starts) - 1):
        first, count = starts[m], starts[m + 1] - starts[m]
        if count < 2:
            continue
        for a in range(count):
            to[a] = place[keyframe[first + a]]
            for r in range(3):
                for c in range(6):
                    pose[_ROWS * a + LANES * r + c] = by_pose[first + a, r, c]
        is_usual = True
        for a in range(count):
            is_usual &= keyframe[first + a] == keyframe[first] + a
        weight = usual[count] if is_usual else own_weight
        if not (is_usual and is_known[count]):
            _position_weights(keyframe, first, count, white, creep, weight)
            is_known[count] = is_usual
        _disparity_weights(by_point, first, count, disparity, bias, weight_d)
        _add_point_normal(by_point, first, count, weight, weight_d, lifted, normal)
        if not _invert_or_drop(normal, inverse):
            continue
        for a in range(count):
            _set_product(coupling, _ROWS * a, lifted, _POINT * a, 3, pose, _ROWS * a)
            _set_product(solved, _ROWS * a, flat_inverse, 0, 3, coupling, _ROWS * a)
        for p in range(count):
            for q in range(p, count):
                if not (wanted[keyframe[first + p]] or wanted[keyframe[first + q]]):
                    continue
                i, j, a, b = to[p], to[q], p, q
                if i > j:  # on and above the diagonal
                    i, j, a, b = j, i, q, p
                w, d = weight[a, b], weight_d[a, b]
                for c in range(LANES):
                    weighted[c] = w * pose[_ROWS * a + c]
                    weighted[LANES + c] = w * pose[_ROWS * a + LANES + c]
                    weighted[2 * LANES + c] = d * pose[_ROWS * a + 2 * LANES + c]
                block = BLOCK * (row[i] + j)
                _add_product(blocks, block, weighted, 0, LANES, pose, _ROWS * b)
                _subtract_product(blocks, block, solved, _ROWS * a, LANES, coupling, _ROWS * b)
    return blocks


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _position_weights(keyframe, first, n, white, creep, weight):  # type: ignore[no-untyped-def]
    """Inverse of the covariance white I + creep min(k_a, k_b), k in keyframes since the first.

    It models patches that drift by a random walk while they are tracked.
    """
    for a in range(n):
        for b in range(a, n):
            weight[a, b] = weight[b, a] = creep * (keyframe[first + a] - keyframe[first])
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


@compiled(**NO_REFCOUNT)
def _disparity_weights(by_point, first, n, disparity, bias, weight):  # type: ignore[no-untyped-def]
    """Inverse of the covariance disparity I + bias 1 1^T, of measured ones (Sherman-Morrison)."""
    measured = 0
    for a in range(n):
        measured += _is_measured(by_point, first + a)
    own = 1.0 / disparity
    shared = bias / (disparity * (disparity + measured * bias))
    for a in range(n):
        is_measured = _is_measured(by_point, first + a)
        for b in range(n):
            both = is_measured and _is_measured(by_point, first + b)
            weight[a, b] = (own if a == b else 0.0) - shared if both else 0.0


@compiled(**NO_REFCOUNT)
def _is_measured(by_point, n):  # type: ignore[no-untyped-def]
    return by_point[n, 2, 0] != 0.0 or by_point[n, 2, 1] != 0.0 or by_point[n, 2, 2] != 0.0


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _add_point_normal(by_point, first, n, weight, weight_d, lifted, normal):  # type: ignore[no-untyped-def]
    """Fill `lifted` with W B, and `normal` with B^T W B."""
    normal[:] = 0.0
    for a in range(n):
        for r in range(3):
            t0 = t1 = t2 = 0.0
            for b in range(n):
                w = weight_d[a, b] if r == 2 else weight[a, b]
                t0 += w * by_point[first + b, r, 0]
                t1 += w * by_point[first + b, r, 1]
                t2 += w * by_point[first + b, r, 2]
            at = _POINT * a + 3 * r
            lifted[at], lifted[at + 1], lifted[at + 2] = t0, t1, t2
            for p in range(3):
                derivative = by_point[first + a, r, p]
                normal[p, 0] += derivative * t0
                normal[p, 1] += derivative * t1
                normal[p, 2] += derivative * t2


@compiled(**NO_REFCOUNT)
def _invert_or_drop(m, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric (3, 3); False if it is singular."""
    determinant, trace = cofactors_of(m, inverse), m[0, 0] + m[1, 1] + m[2, 2]
    if not determinant > SINGULAR * trace * trace * trace:
        return False
    divide(inverse, determinant)
    return True
