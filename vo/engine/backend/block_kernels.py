"""Compiled normal equations of poses with the points eliminated, in blocks of 6 x 6.

For poses p, points l, Jacobians A = de/dp and B = de/dl, and whitened, weighted errors e, the
normal equations of a bundle are block diagonal in the points, and the Schur complement is

    H = sum A^T A - sum (A^T B) (B^T B)^-1 (B^T A),    g = sum A^T e - sum (A^T B) (B^T B)^-1 B^T e.

One point is processed at a time, so that its Jacobians stay in the cache.

Layout: everything is in flat float64 arrays, because views cost reference counts. A Jacobian of an
observation by a pose is 3 rows (u, v, disparity); each row is padded to the 8 numbers of a vector
register. Blocks of H are those of `block_matrix`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, Intrinsic, compiled
from vo.base.geometry.projection import (
    MIN_DEPTH,
    by_world_axis,
    by_world_from_cam,
    pixel,
    point_derivatives,
    to_camera,
)
from vo.engine.backend.block_matrix import BLOCK, LANES, assembled

_REGULARISATION = 1e-12  # added to a point's normal matrix, relative to its trace

# Sizes of a Jacobian by a pose, of one by a point, and of errors.
_ROWS, _POINT, _ERRORS = 3 * LANES, 9, 3

_set_product = Intrinsic("vo.engine.backend.intrinsics", "set_product")
_add_product = Intrinsic("vo.engine.backend.intrinsics", "add_product")
_subtract_product = Intrinsic("vo.engine.backend.intrinsics", "subtract_product")
_add_row = Intrinsic("vo.engine.backend.intrinsics", "add_row")
_subtract_row = Intrinsic("vo.engine.backend.intrinsics", "subtract_row")


def reduced(points: Any, poses: Any, slot: Any, calibrates: bool, views: Any) -> Any:
    """H (6 F, 6 F) and g (6 F,) of the F free poses, of which any two may be coupled."""
    free = int(slot.max()) + 1
    size = free + calibrates
    row, end = size * np.arange(size), np.full(size, free)
    blocks, gradient = reduced_blocks(points, poses, slot, calibrates, row, end, views)
    return assembled(blocks, row, 0, size, size), gradient


@compiled(fastmath={"contract"})
def reduced_blocks(  # type: ignore[no-untyped-def]
    points, poses, slot, calibrates, row, end, views
):
    """Blocks of the Schur complement H on and above the diagonal, and g (6 F,) of F free poses.

    Args:
        points: (M, 3) in the world.
        poses: (K, 3, 4) cam_from_world.
        slot: (K,) number among the free poses, -1 if fixed; it must increase.
        calibrates: whether six rows are appended, the first of them for the
            `CalibrationResidual`: the blocks treat it as one more pose that all observations have
            in common.
        row: (F,) block (a, b) has the number row[a] + b.
        end: (F,) of the appended rows: (a, F) has the number row[a] + end[a].
        views: the observations, a `PointViews`.
    """
    size = len(row)
    free = size - 1 if calibrates else size
    count = row[size - 1] + size if size > 0 else 0
    blocks, gradient = np.zeros(count * BLOCK), np.zeros(size * LANES)
    starts, keyframe = views.starts, views.camera
    max_views = 1
    for m in range(len(starts) - 1):
        max_views = max(max_views, starts[m + 1] - starts[m] + 1)
    by_pose, by_rest = np.zeros(max_views * _ROWS), np.zeros(max_views * _ROWS)
    by_point, error = np.zeros(max_views * _POINT), np.zeros(max_views * _ERRORS)
    coupling, lifted, shared = np.zeros(max_views * _ROWS), np.zeros(_ROWS), np.zeros(_ROWS)
    at, column = np.zeros(max_views, dtype=np.int64), np.zeros(max_views, dtype=np.int64)
    normal, inverse, right = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    flat_inverse = inverse.reshape(-1)
    for m in range(len(starts) - 1):
        first, count = starts[m], starts[m + 1] - starts[m]
        if count == 0:
            continue
        # All Jacobians are written before the products read them: a vector load soon after scalar
        # stores to the same place would stall.
        _differentiate(
            points, poses, m, first, count, views, by_pose, by_point, by_rest, error, normal, right
        )
        shared[:] = 0.0
        tied = 0
        for a in range(count):
            k, pose, point = slot[keyframe[first + a]], _ROWS * a, _POINT * a
            if calibrates:
                _set_product(lifted, 0, by_point, point, 3, by_rest, pose)
                for c in range(_ROWS):
                    shared[c] += lifted[c]
                corner = BLOCK * (row[free] + free)
                _add_product(blocks, corner, by_rest, pose, LANES, by_rest, pose)
                _add_row(gradient, LANES * free, error, _ERRORS * a, 1, by_rest, pose)
                if k >= 0:
                    side = BLOCK * (row[k] + end[k])
                    _add_product(blocks, side, by_pose, pose, LANES, by_rest, pose)
            if k < 0:
                continue
            at[tied] = column[tied] = k
            _add_product(blocks, BLOCK * (row[k] + k), by_pose, pose, LANES, by_pose, pose)
            _set_product(coupling, _ROWS * tied, by_point, point, 3, by_pose, pose)
            _add_row(gradient, LANES * k, error, _ERRORS * a, 1, by_pose, pose)
            tied += 1
        if calibrates:
            at[tied] = free
            for c in range(_ROWS):
                coupling[_ROWS * tied + c] = shared[c]
            tied += 1
        _invert(normal, inverse)
        # Subtract (A^T B) (B^T B)^-1 (B^T A) for all pairs of poses; `at` increases, so that they
        # are on and above the diagonal. `coupling` holds B^T A (3 x 6) of each pose.
        for a in range(tied):
            _set_product(lifted, 0, flat_inverse, 0, 3, coupling, _ROWS * a)  # it is symmetric
            _subtract_row(gradient, LANES * at[a], right, 0, 1, lifted, 0)
            base = row[at[a]]
            if calibrates:
                column[tied - 1] = end[at[a]]
            for b in range(a, tied):
                block = BLOCK * (base + column[b])
                _subtract_product(blocks, block, lifted, 0, LANES, coupling, _ROWS * b)
    whole = np.zeros(6 * size)
    for r in range(6 * size):
        whole[r] = gradient[LANES * (r // 6) + r % 6]
    return blocks, whole


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _differentiate(  # type: ignore[no-untyped-def]
    points, poses, m, first, count, views, by_pose, by_point, by_rest, error, normal, right
):
    """Linearise the observations of point m.

    Fills, weighted by 1 / sigma and the root of Huber's weight: `by_pose` A, `by_point` B (3 x 3),
    `by_rest` (derivatives by the calibration residual), `error` e; and of the point `normal` B^T B
    and `right` B^T e. Observations from behind the camera are 0.
    """
    _, keyframe, xy, disparity, inverse_sigma, intrinsics, fb, inverse_d, huber, k1, k2 = views
    p0, p1, p2 = points[m, 0], points[m, 1], points[m, 2]
    n00 = n01 = n02 = n11 = n12 = n22 = 0.0
    r0 = r1 = r2 = 0.0
    for a in range(count):
        n, j, i, e = first + a, _ROWS * a, _POINT * a, _ERRORS * a
        k = keyframe[n]
        pose = poses[k]
        x, y, z = to_camera(pose, p0, p1, p2)
        if z < MIN_DEPTH:
            by_pose[j : j + _ROWS], by_rest[j : j + _ROWS] = 0.0, 0.0
            by_point[i : i + _POINT], error[e : e + _ERRORS] = 0.0, 0.0
            continue
        s, near = inverse_sigma[n], 1.0 / z  # the only division
        x, y = x * near, y * near
        u, v = pixel(intrinsics, x, y, 1.0)
        eu, ev = s * (u - xy[n, 0]), s * (v - xy[n, 1])
        measured = fb > 0.0 and not np.isnan(disparity[n])
        ed = inverse_d * (fb * near - disparity[n]) if measured else 0.0
        t = inverse_d if measured else 0.0
        length = np.sqrt(eu * eu + ev * ev + ed * ed)
        weight = 1.0 if length <= huber else np.sqrt(huber / length)
        eu, ev, ed, s, t = weight * eu, weight * ev, weight * ed, weight * s, weight * t
        error[e], error[e + 1], error[e + 2] = eu, ev, ed
        ju, jv, jd = j, j + LANES, j + 2 * LANES
        if fb > 0.0:
            right_x = x - fb / intrinsics.fx * near
            by_rest[jd], by_rest[jd + 1] = t, t * right_x * right_x
            # The same radial distortion in both cameras, see `CalibrationResidual.bend`.
            square, fx = x * x + y * y, intrinsics.fx
            by_rest[ju + 2], by_rest[jv + 2] = s * fx * x * square, s * intrinsics.fy * y * square
            by_rest[jd + 2] = t * fx * (x * square - right_x * (right_x * right_x + y * y))
        else:  # at the predicted pixel, because noise of the measured one would not average out
            square = x * x + y * y
            # How recorded radii become ideal ones: derivative, and ratio; 1 without distortion.
            along = 1.0 / (1.0 + square * (3.0 * k1 + 5.0 * k2 * square))
            across = 1.0 / (1.0 + square * (k1 + k2 * square))
            stretch = s * square * along
            by_rest[ju], by_rest[jv] = stretch * intrinsics.fx * x, stretch * intrinsics.fy * y
            # The next power of the radius, see `CalibrationResidual.bend`.
            by_rest[ju + 1], by_rest[jv + 1] = square * by_rest[ju], square * by_rest[jv]
            # The logarithm of the focal length, and the principal point, see `lens_adjustment`.
            longer = s * along / across
            by_rest[ju + 2], by_rest[jv + 2] = (
                longer * intrinsics.fx * x,
                longer * intrinsics.fy * y,
            )
            turned = s * (along - across) / square if square > 0.0 else 0.0
            by_rest[ju + 3], by_rest[jv + 4] = (
                s * across + turned * x * x,
                s * across + turned * y * y,
            )
            by_rest[jv + 3] = by_rest[ju + 4] = turned * x * y
        in_cam = point_derivatives(s * intrinsics.fx, s * intrinsics.fy, t * fb, x, y, 1.0, near)
        by_u, by_v, by_d = by_world_from_cam(in_cam, x * z, y * z, z)
        by_pose[ju], by_pose[ju + 1], by_pose[ju + 2] = by_u[0], by_u[1], by_u[2]
        by_pose[ju + 3], by_pose[ju + 4], by_pose[ju + 5] = by_u[3], by_u[4], by_u[5]
        by_pose[jv], by_pose[jv + 1], by_pose[jv + 2] = by_v[0], by_v[1], by_v[2]
        by_pose[jv + 3], by_pose[jv + 4], by_pose[jv + 5] = by_v[3], by_v[4], by_v[5]
        by_pose[jd], by_pose[jd + 1], by_pose[jd + 2] = by_d[0], by_d[1], by_d[2]
        by_pose[jd + 3], by_pose[jd + 4], by_pose[jd + 5] = by_d[3], by_d[4], by_d[5]
        # Loaded first: otherwise LLVM fuses other products with sums, and results differ in bits.
        z0, z1, z2 = pose[2, 0], pose[2, 1], pose[2, 2]
        u0, v0, d0 = by_world_axis(in_cam, pose[0, 0], pose[1, 0], z0)
        u1, v1, d1 = by_world_axis(in_cam, pose[0, 1], pose[1, 1], z1)
        u2, v2, d2 = by_world_axis(in_cam, pose[0, 2], pose[1, 2], z2)
        by_point[i], by_point[i + 1], by_point[i + 2] = u0, u1, u2
        by_point[i + 3], by_point[i + 4], by_point[i + 5] = v0, v1, v2
        by_point[i + 6], by_point[i + 7], by_point[i + 8] = d0, d1, d2
        r0 += u0 * eu + v0 * ev + d0 * ed
        r1 += u1 * eu + v1 * ev + d1 * ed
        r2 += u2 * eu + v2 * ev + d2 * ed
        n00 += u0 * u0 + v0 * v0 + d0 * d0
        n01 += u0 * u1 + v0 * v1 + d0 * d1
        n02 += u0 * u2 + v0 * v2 + d0 * d2
        n11 += u1 * u1 + v1 * v1 + d1 * d1
        n12 += u1 * u2 + v1 * v2 + d1 * d2
        n22 += u2 * u2 + v2 * v2 + d2 * d2
    right[0], right[1], right[2] = r0, r1, r2
    normal[0, 0], normal[1, 1], normal[2, 2] = n00, n11, n22
    normal[0, 1], normal[1, 0] = n01, n01
    normal[0, 2], normal[2, 0] = n02, n02
    normal[1, 2], normal[2, 1] = n12, n12


@compiled(**NO_REFCOUNT)
def _invert(m, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a point's (3, 3) normal matrix, slightly regularised.

    A direction that is not determined (the depth, without parallax) does not couple poses either,
    so that the regularisation has no other effect.
    """
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace == 0.0:
        inverse[:] = 0.0
        return
    for p in range(3):
        m[p, p] += _REGULARISATION * trace
    divide(inverse, cofactors_of(m, inverse))


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def cofactors_of(m, cofactors):  # type: ignore[no-untyped-def]
    """Fill cofactors on and above the diagonal of a symmetric (3, 3); gives the determinant."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    cofactors[0, 0], cofactors[0, 1], cofactors[0, 2] = c00, c01, c02
    cofactors[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    cofactors[1, 2] = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    cofactors[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    return m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02


@compiled(**NO_REFCOUNT)
def divide(inverse, determinant):  # type: ignore[no-untyped-def]
    """Turn cofactors on and above the diagonal into the inverse."""
    for p in range(3):
        for q in range(p, 3):
            inverse[p, q] /= determinant
            inverse[q, p] = inverse[p, q]
