"""Compiled normal equations of poses by blocks of 6 x 6, the points eliminated.

Rows of a block, and of what it is made from, are padded to the 8 numbers of a vector register.
"""

from __future__ import annotations

import numpy as np

from vo.compiling.function import WrittenOut, compiled

_LANES = 8
_UNSEEN = 1e-12  # information on a point in every direction, against all it has
_NEAREST = 1e-6  # depth from which on a point is in front
_SINGULAR = 1e-13  # pivot of a point's normal matrix, against its trace, below which it is dropped

_set_product = WrittenOut("vo.smoothing.instructions", "set_product")
_add_product = WrittenOut("vo.smoothing.instructions", "add_product")
_subtract_product = WrittenOut("vo.smoothing.instructions", "subtract_product")


@compiled
def reduced(  # type: ignore[no-untyped-def]
    points,
    poses,
    slot,
    calibrates,
    starts,
    keyframe,
    xy,
    disparity,
    inverse_sigma,
    intrinsics,
    fb,
    inverse_d,
    huber,
):
    """Normal equations of the poses that may move, the points eliminated.

    With `calibrates` six rows follow, of which the first are those of what the calibration leaves
    (`Miscalibration`): to the blocks it is one more pose, which all observations share.
    """
    free = slot.max() + 1
    size = free + 1 if calibrates else free
    # By blocks of 6 x 6, those on and above the diagonal: a block's rows lie side by side.
    blocks, gradient = np.zeros((size, size, 6, _LANES)), np.zeros((size, 6))
    most = 1
    for m in range(len(starts) - 1):
        most = max(most, starts[m + 1] - starts[m] + 1)
    by_pose, by_rest = np.zeros((3, _LANES)), np.zeros((3, _LANES))
    by_point, error = np.zeros((3, 3)), np.zeros(3)
    coupling, lifted = np.zeros((most, 3, _LANES)), np.zeros((3, _LANES))
    shared = np.zeros((3, _LANES))
    at = np.zeros(most, dtype=np.int64)
    normal, inverse, right = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        if last == first:
            continue
        count = 0
        normal[:], right[:], shared[:] = 0.0, 0.0, 0.0
        for a in range(first, last):
            _jacobians(
                points[m],
                poses[keyframe[a]],
                xy[a],
                disparity[a],
                inverse_sigma[a],
                intrinsics,
                fb,
                inverse_d,
                huber,
                by_pose,
                by_point,
                by_rest,
                error,
            )
            for p in range(3):
                u, v, d = by_point[0, p], by_point[1, p], by_point[2, p]
                right[p] += u * error[0] + v * error[1] + d * error[2]
                for q in range(3):
                    normal[p, q] += u * by_point[0, q] + v * by_point[1, q] + d * by_point[2, q]
            k = slot[keyframe[a]]
            if calibrates:
                _set_product(lifted, by_point, by_rest)
                shared += lifted
                _add_product(blocks[free, free], by_rest, by_rest)
                _add_gradient(gradient[free], by_rest, error)
                if k >= 0:
                    _add_product(blocks[k, free], by_pose, by_rest)
            if k < 0:
                continue
            at[count] = k
            _add_product(blocks[k, k], by_pose, by_pose)
            _set_product(coupling[count], by_point, by_pose)
            _add_gradient(gradient[k], by_pose, error)
            count += 1
        if calibrates:
            at[count] = free
            coupling[count] = shared
            count += 1
        _invert(normal, inverse)
        _subtract_point(at[:count], coupling, lifted, inverse, right, blocks, gradient)
    return _assembled(blocks, gradient)


@compiled
def _add_gradient(gradient, by, error):  # type: ignore[no-untyped-def]
    for c in range(6):
        gradient[c] += by[0, c] * error[0] + by[1, c] * error[1] + by[2, c] * error[2]


@compiled
def _jacobians(  # type: ignore[no-untyped-def]
    at,
    pose,
    xy,
    disparity,
    s,
    intrinsics,
    fb,
    inverse_d,
    huber,
    by_pose,
    by_point,
    by_rest,
    error,
):
    """Fill an observation's derivatives and errors, weighted."""
    x = pose[0, 0] * at[0] + pose[0, 1] * at[1] + pose[0, 2] * at[2] + pose[0, 3]
    y = pose[1, 0] * at[0] + pose[1, 1] * at[1] + pose[1, 2] * at[2] + pose[1, 3]
    z = pose[2, 0] * at[0] + pose[2, 1] * at[1] + pose[2, 2] * at[2] + pose[2, 3]
    if z < _NEAREST:
        by_pose[:], by_point[:], by_rest[:], error[:] = 0.0, 0.0, 0.0, 0.0
        return
    eu = s * (intrinsics[0] * x / z + intrinsics[2] - xy[0])
    ev = s * (intrinsics[1] * y / z + intrinsics[3] - xy[1])
    measured = fb > 0.0 and not np.isnan(disparity)
    ed = inverse_d * (fb / z - disparity) if measured else 0.0
    t = inverse_d if measured else 0.0
    length = np.sqrt(eu * eu + ev * ev + ed * ed)
    weight = 1.0 if length <= huber else np.sqrt(huber / length)
    error[0], error[1], error[2] = weight * eu, weight * ev, weight * ed
    if fb > 0.0:
        right_x = (x - fb / intrinsics[0]) / z
        by_rest[2, 0], by_rest[2, 1] = weight * t, weight * t * right_x * right_x
    else:  # taken where the point should be: what depends on the error itself would not average
        stretch = weight * s * (x * x + y * y) / (z * z * z)
        by_rest[0, 0], by_rest[1, 0] = stretch * intrinsics[0] * x, stretch * intrinsics[1] * y
    du, dv = weight * s * intrinsics[0] / z, weight * s * intrinsics[1] / z
    cu, cv, cd = -du * x / z, -dv * y / z, -weight * t * fb / (z * z)
    for p in range(3):
        by_point[0, p] = du * pose[0, p] + cu * pose[2, p]
        by_point[1, p] = dv * pose[1, p] + cv * pose[2, p]
        by_point[2, p] = cd * pose[2, p]
    # A motion exp(xi) of the camera's own frame moves a point in it by -(rho + phi x p).
    by_pose[0, 0], by_pose[0, 1], by_pose[0, 2] = -cu * y, cu * x - du * z, du * y
    by_pose[1, 0], by_pose[1, 1], by_pose[1, 2] = dv * z - cv * y, cv * x, -dv * x
    by_pose[2, 0], by_pose[2, 1] = -cd * y, cd * x
    by_pose[0, 3], by_pose[0, 5] = -du, -cu
    by_pose[1, 4], by_pose[1, 5] = -dv, -cv
    by_pose[2, 5] = -cd
    by_pose[0, 4], by_pose[1, 3] = 0.0, 0.0
    by_pose[2, 2], by_pose[2, 3], by_pose[2, 4] = 0.0, 0.0, 0.0


@compiled
def _subtract_point(at, coupling, lifted, inverse, right, blocks, gradient):  # type: ignore[no-untyped-def]
    """What poses and calibration lose because the point may move too; `at` grows."""
    for a in range(len(at)):
        _set_product(lifted, inverse, coupling[a])  # the inverse is symmetric
        to = gradient[at[a]]
        for c in range(6):
            to[c] -= lifted[0, c] * right[0] + lifted[1, c] * right[1] + lifted[2, c] * right[2]
        for b in range(a, len(at)):
            _subtract_product(blocks[at[a], at[b]], lifted, coupling[b])


@compiled
def _assembled(blocks, gradient):  # type: ignore[no-untyped-def]
    """Hessian (6 B, 6 B) and gradient (6 B,) of B blocks."""
    size = 6 * len(blocks)
    hessian, whole = np.zeros((size, size)), np.zeros(size)
    for r in range(size):
        a, c = divmod(r, 6)
        whole[r] = gradient[a, c]
        for column in range(r, size):
            b, e = divmod(column, 6)
            hessian[r, column] = hessian[column, r] = blocks[a, b, c, e]
    return hessian, whole


@compiled
def _invert(m, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a point's (3, 3) normal matrix.

    What no view tells of a point (its depth, without parallax) ties no poses together either: a
    trace of information in every direction makes the matrix regular and changes nothing else.
    """
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace == 0.0:
        inverse[:] = 0.0
        return
    for p in range(3):
        m[p, p] += _UNSEEN * trace
    _divide(inverse, _cofactors(m, inverse))


@compiled
def _invert_or_drop(m, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric (3, 3); False if it is singular."""
    determinant, trace = _cofactors(m, inverse), m[0, 0] + m[1, 1] + m[2, 2]
    if not determinant > _SINGULAR * trace * trace * trace:
        return False
    _divide(inverse, determinant)
    return True


@compiled
def _cofactors(m, cofactors):  # type: ignore[no-untyped-def]
    """Fill those on and above the diagonal of a symmetric (3, 3); gives the determinant."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    cofactors[0, 0], cofactors[0, 1], cofactors[0, 2] = c00, c01, c02
    cofactors[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    cofactors[1, 2] = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    cofactors[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    return m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02


@compiled
def _divide(inverse, determinant):  # type: ignore[no-untyped-def]
    """Make an inverse of cofactors on and above the diagonal."""
    for p in range(3):
        for q in range(p, 3):
            inverse[p, q] /= determinant
            inverse[q, p] = inverse[p, q]


@compiled
def eliminated(  # type: ignore[no-untyped-def]
    poses, starts, keyframe, by_pose, by_point, white, creep, disparity, bias
):
    """See `information.pose_information`: (6 K, 6 K) of K poses, of observations side by side."""
    # By blocks of 6 x 6, those on and above the diagonal: a block's rows lie side by side.
    blocks = np.zeros((poses, poses, 6, _LANES))
    most = 0
    for m in range(len(starts) - 1):
        most = max(most, starts[m + 1] - starts[m])
    weight, weight_d = np.zeros((most, most)), np.zeros((most, most))
    lifted, pose = np.zeros((most, 3, 3)), np.zeros((most, 3, _LANES))
    coupling, solved = np.zeros((most, 3, _LANES)), np.zeros((most, 3, _LANES))
    normal, inverse = np.zeros((3, 3)), np.zeros((3, 3))
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        if last - first < 2:
            continue
        at, point = keyframe[first:last], by_point[first:last]
        for a in range(last - first):
            for r in range(3):
                for c in range(6):
                    pose[a, r, c] = by_pose[first + a, r, c]
        _position_weights(at, white, creep, weight)
        _disparity_weights(point, disparity, bias, weight_d)
        _add_point_normal(point, weight, weight_d, lifted, normal)
        if _invert_or_drop(normal, inverse):
            _couple(pose[: len(at)], lifted, inverse, coupling, solved)
            _add_point(at, pose, weight, weight_d, coupling, solved, blocks)
    information = np.zeros((6 * poses, 6 * poses))
    for r in range(6 * poses):
        for c in range(r, 6 * poses):
            information[r, c] = information[c, r] = blocks[r // 6, c // 6, r % 6, c % 6]
    return information


@compiled
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


@compiled
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


@compiled
def _is_measured(point, a):  # type: ignore[no-untyped-def]
    return point[a, 2, 0] != 0.0 or point[a, 2, 1] != 0.0 or point[a, 2, 2] != 0.0


@compiled
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


@compiled
def _couple(pose, lifted, inverse, coupling, solved):  # type: ignore[no-untyped-def]
    """Fill how each observation ties a point to its pose, and that times the point's covariance."""
    for a in range(len(pose)):
        _set_product(coupling[a], lifted[a], pose[a])
        _set_product(solved[a], inverse, coupling[a])


@compiled
def _add_point(at, pose, weight, weight_d, coupling, solved, blocks):  # type: ignore[no-untyped-def]
    """What the observations of one point say of their poses, the point eliminated."""
    weighted = np.empty((3, _LANES))
    for a in range(len(at)):
        for b in range(a, len(at)):
            for k in range(3):
                w = weight_d[a, b] if k == 2 else weight[a, b]
                for c in range(_LANES):
                    weighted[k, c] = w * pose[a, k, c]
            _add_product(blocks[at[a], at[b]], weighted, pose[b])
            _subtract_product(blocks[at[a], at[b]], solved[a], coupling[b])
