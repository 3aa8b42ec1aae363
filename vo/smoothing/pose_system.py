"""The window's normal equations at its solution, with the points eliminated.

What is left speaks of the poses and of one constant error of all disparities: it gives the
covariances and tells a wrong stereo calibration.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from vo.config import SmoothingConfig
from vo.smoothing.residuals import residuals
from vo.types import Bools, Floats, Ints, WindowProblem

_SINGULAR = 1e-13  # pivot of a point's normal matrix, against its trace, below which it is dropped


class PoseSystem(NamedTuple):
    """Normal equations of K poses, 6 rows each, and of the disparity offset, the last row.

    Attributes:
        hessian: (6 K + 1, 6 K + 1).
        gradient: (6 K + 1,).
        seen: (K,) observations that each pose has.
    """

    hessian: Floats
    gradient: Floats
    seen: Ints


def pose_system(
    problem: WindowProblem,
    world_from_cam: Floats,
    points: Floats,
    point_ok: Bools,
    config: SmoothingConfig,
) -> PoseSystem:
    """Linearise a window with Huber weights and eliminate its points by the Schur complement.

    Points that their observations do not determine are left out. The tangent of a pose is (rx ry
    rz tx ty tz) in the camera's own frame.

    Source: Triggs et al., "Bundle Adjustment", 2000, sec. 6.1.
    """
    residual, depth = residuals(problem, world_from_cam, points, config.sigma_disparity_px)
    used = np.flatnonzero(point_ok[problem.point] & (depth > 0) & np.isfinite(residual))
    order = used[np.argsort(problem.point[used], kind="stable")]
    starts = np.searchsorted(problem.point[order], np.arange(len(points) + 1))
    weight = np.sqrt(config.huber / np.maximum(residual, config.huber))
    hessian, gradient = _eliminated(
        np.ascontiguousarray(world_from_cam),
        np.ascontiguousarray(points),
        order,
        starts,
        problem.keyframe,
        problem.xy,
        problem.disparity,
        problem.sigma_px,
        config.sigma_disparity_px,
        weight,
        np.array(problem.intrinsics),
        problem.intrinsics[0] * problem.baseline_m,
    )
    seen = np.bincount(problem.keyframe[used], minlength=len(world_from_cam))
    return PoseSystem(hessian, gradient, seen)


@numba.njit(cache=True, nogil=True)
def _eliminated(  # type: ignore[no-untyped-def]
    poses, points, order, starts, keyframe, xy, disparity, sigma, sigma_d, weight, intrinsics, fb
):
    size = 6 * len(poses) + 1
    hessian = np.zeros((size, size))
    gradient = np.zeros(size)
    most = 0
    for m in range(len(points)):
        most = max(most, starts[m + 1] - starts[m])
    by_pose, by_point = np.zeros((most, 3, 6)), np.zeros((most, 3, 3))
    by_offset, error = np.zeros(most), np.zeros((most, 3))
    normal, inverse = np.zeros((3, 3)), np.zeros((3, 3))
    for m in range(len(points)):
        rows = order[starts[m] : starts[m + 1]]
        for a in range(len(rows)):
            i = rows[a]
            by_offset[a] = _linearise(
                poses[keyframe[i]],
                points[m],
                xy[i],
                disparity[i],
                sigma[i],
                sigma_d,
                weight[i],
                intrinsics,
                fb,
                by_pose[a],
                by_point[a],
                error[a],
            )
        _add_point_normal(by_point, len(rows), normal)
        if len(rows) > 0 and _invert(normal, inverse):
            at = 6 * keyframe[rows]
            _add_poses(at, by_pose, by_offset, error, hessian, gradient)
            _subtract_point(at, by_pose, by_point, by_offset, error, inverse, hessian, gradient)
    for r in range(size):
        for c in range(r):
            hessian[r, c] = hessian[c, r]
    return hessian, gradient


@numba.njit(cache=True, nogil=True)
def _linearise(  # type: ignore[no-untyped-def]
    pose, point, xy, disparity, sigma, sigma_d, weight, intrinsics, fb, by_pose, by_point, error
):
    """Fill the weighted errors and derivatives of one observation; returns that by the offset."""
    fx, fy, cx, cy = intrinsics
    d0, d1, d2 = point[0] - pose[0, 3], point[1] - pose[1, 3], point[2] - pose[2, 3]
    x = pose[0, 0] * d0 + pose[1, 0] * d1 + pose[2, 0] * d2
    y = pose[0, 1] * d0 + pose[1, 1] * d1 + pose[2, 1] * d2
    z = pose[0, 2] * d0 + pose[1, 2] * d1 + pose[2, 2] * d2
    s = weight / sigma
    measured = fb > 0.0 and not np.isnan(disparity)
    t = weight / sigma_d if measured else 0.0
    error[0] = s * (fx * x / z + cx - xy[0])
    error[1] = s * (fy * y / z + cy - xy[1])
    error[2] = t * (fb / z - disparity) if measured else 0.0
    for r in range(3):
        a = s * fx / z if r == 0 else 0.0
        b = s * fy / z if r == 1 else 0.0
        if r == 0:
            c = -s * fx * x / (z * z)
        elif r == 1:
            c = -s * fy * y / (z * z)
        else:
            c = -t * fb / (z * z)
        for k in range(3):
            by_point[r, k] = a * pose[k, 0] + b * pose[k, 1] + c * pose[k, 2]
        # A motion exp(xi) of the camera's own frame moves a point in it by -(rho + phi x p).
        by_pose[r, 0] = b * z - c * y
        by_pose[r, 1] = c * x - a * z
        by_pose[r, 2] = a * y - b * x
        by_pose[r, 3], by_pose[r, 4], by_pose[r, 5] = -a, -b, -c
    return t


@numba.njit(cache=True, nogil=True)
def _add_point_normal(by_point, count, normal):  # type: ignore[no-untyped-def]
    normal[:] = 0.0
    for a in range(count):
        for p in range(3):
            for q in range(3):
                for r in range(3):
                    normal[p, q] += by_point[a, r, p] * by_point[a, r, q]


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
def _add_poses(at, by_pose, by_offset, error, hessian, gradient):  # type: ignore[no-untyped-def]
    """What the observations of one point say of their poses (rows `at`) and of the offset."""
    last = len(gradient) - 1
    for a in range(len(at)):
        hessian[last, last] += by_offset[a] * by_offset[a]
        gradient[last] += by_offset[a] * error[a, 2]
        for c in range(6):
            row = at[a] + c
            hessian[row, last] += by_pose[a, 2, c] * by_offset[a]
            for r in range(3):
                gradient[row] += by_pose[a, r, c] * error[a, r]
                for d in range(c, 6):
                    hessian[row, at[a] + d] += by_pose[a, r, c] * by_pose[a, r, d]


@numba.njit(cache=True, nogil=True)
def _subtract_point(  # type: ignore[no-untyped-def]
    at, by_pose, by_point, by_offset, error, inverse, hessian, gradient
):
    """The Schur complement of one point, of which `inverse` is the inverted normal matrix."""
    count, last = len(at), len(gradient) - 1
    coupling, lifted = np.zeros((count, 3, 6)), np.zeros((count, 3, 6))
    offset, right = np.zeros(3), np.zeros(3)
    for a in range(count):
        for p in range(3):
            offset[p] += by_point[a, 2, p] * by_offset[a]
            for r in range(3):
                right[p] += by_point[a, r, p] * error[a, r]
                for c in range(6):
                    coupling[a, p, c] += by_point[a, r, p] * by_pose[a, r, c]
    for a in range(count):
        for p in range(3):
            for q in range(3):
                for c in range(6):
                    lifted[a, p, c] += inverse[p, q] * coupling[a, q, c]
    for p in range(3):
        for q in range(3):
            shared = offset[p] * inverse[p, q]
            hessian[last, last] -= shared * offset[q]
            gradient[last] -= shared * right[q]
    for a in range(count):
        for p in range(3):
            for c in range(6):
                hessian[at[a] + c, last] -= lifted[a, p, c] * offset[p]
                gradient[at[a] + c] -= lifted[a, p, c] * right[p]
        for b in range(count):
            if at[b] >= at[a]:
                for p in range(3):
                    for c in range(6):
                        for d in range(6):
                            product = lifted[a, p, c] * coupling[b, p, d]
                            hessian[at[a] + c, at[b] + d] -= product
