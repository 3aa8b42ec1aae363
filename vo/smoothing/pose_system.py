"""The window's normal equations at its solution, with the points eliminated.

What is left speaks of the poses and of one constant error of all disparities: it tells a wrong
stereo calibration.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from vo.smoothing.linearisation import Linearised
from vo.types import Floats

_SINGULAR = 1e-13  # pivot of a point's normal matrix, against its trace, below which it is dropped


class PoseSystem(NamedTuple):
    """Normal equations of K poses, 6 rows each, and of the disparity offset, the last row.

    Attributes:
        hessian: (6 K + 1, 6 K + 1).
        gradient: (6 K + 1,).
    """

    hessian: Floats
    gradient: Floats


def pose_system(linear: Linearised) -> PoseSystem:
    """Eliminate a window's points by the Schur complement.

    Points that their observations do not determine are left out.

    Source: Triggs et al., "Bundle Adjustment", 2000, sec. 6.1.
    """
    arrays = (linear.by_pose, linear.by_point, linear.by_offset, linear.error)
    return PoseSystem(*_eliminated(linear.poses, linear.starts, linear.keyframe, *arrays))


@numba.njit(cache=True, nogil=True)
def _eliminated(  # type: ignore[no-untyped-def]
    poses, starts, keyframe, by_pose, by_point, by_offset, error
):
    size = 6 * poses + 1
    hessian = np.zeros((size, size))
    gradient = np.zeros(size)
    normal, inverse = np.zeros((3, 3)), np.zeros((3, 3))
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        at, offset, wrong = 6 * keyframe[first:last], by_offset[first:last], error[first:last]
        pose, point = by_pose[first:last], by_point[first:last]
        _add_point_normal(point, last - first, normal)
        if last > first and _invert(normal, inverse):
            _add_poses(at, pose, offset, wrong, hessian, gradient)
            _subtract_point(at, pose, point, offset, wrong, inverse, hessian, gradient)
    for r in range(size):
        for c in range(r):
            hessian[r, c] = hessian[c, r]
    return hessian, gradient


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
