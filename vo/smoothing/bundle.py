"""Bundle adjustment seen by its poses alone: every point lies where its observations want it.

For given poses each point is put where its robust cost is least, so that the cost is a function of
the poses, and its normal equations are those of the window with the points eliminated. Points do
not depend on one another once the poses are given, which makes this a sum over points.

Source: Carlone et al., "Eliminating Conditionally Independent Sets in Factor Graphs", 2014 (smart
factors); Golub and Pereyra, "The Differentiation of Pseudo-Inverses", 1973 (variable projection).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from vo.geometry.points import PointViews, best_points, point_views
from vo.geometry.transforms import inverse
from vo.types import Bools, Floats, WindowProblem

if TYPE_CHECKING:  # the smoother's process does without the settings, see `vo.smoothing.process`
    from vo.config import SmoothingConfig

_UNSEEN = 1e-12  # information on a point in every direction, against all it has
_NEAREST = 1e-6  # depth from which on a point is in front


class NormalEquations(NamedTuple):
    """hessian @ step = -gradient for F poses that may move, 6 rows each, and what they cost.

    The last row is that of a constant error of all disparities, which is 0 so far.

    Attributes:
        hessian: (6 F + 1, 6 F + 1).
        gradient: (6 F + 1,).
        cost: half the sum of squares, robust.
    """

    hessian: Floats
    gradient: Floats
    cost: float


class Bundle:
    """Observations of a window's points, and where the points lay when it was last linearised.

    The tangent of a pose is (rx ry rz tx ty tz) in the camera's own frame.
    """

    def __init__(self, problem: WindowProblem, point_ok: Bools, config: SmoothingConfig) -> None:
        self._points = np.ascontiguousarray(problem.points)
        self._latest: _Best | None = None
        self._views = views_of(problem, point_ok, config)
        self._slot = np.where(problem.fixed, -1, np.cumsum(~problem.fixed) - 1)
        self._config = config

    def cost(self, world_from_cam: Floats) -> float:
        """Half the robust sum of squares for poses (K, 4, 4), every point at its best."""
        return self._at(world_from_cam).cost

    def points_for(self, world_from_cam: Floats) -> Floats:
        """(M, 3) points at their best for poses (K, 4, 4)."""
        return self._at(world_from_cam).points

    def normal_equations(self, world_from_cam: Floats) -> NormalEquations:
        """Linearise at poses (K, 4, 4) and their points; later searches for points start there."""
        at = self._at(world_from_cam)
        self._points = at.points
        poses = np.ascontiguousarray(inverse(world_from_cam)[:, :3])
        hessian, gradient = _reduced(at.points, poses, self._slot, *self._views)
        return NormalEquations(hessian, gradient, at.cost)

    def _at(self, world_from_cam: Floats) -> _Best:
        """Optimisers ask for the same poses' cost first and their derivatives later."""
        if self._latest is None or not np.array_equal(world_from_cam, self._latest.world_from_cam):
            # Points must not be coarser than the poses, whose steps are judged by the cost.
            tolerance = 0.1 * self._config.relative_error_tolerance
            points, cost = best_points(
                self._points,
                inverse(world_from_cam),
                self._views,
                steps=self._config.iterations,
                tolerance=tolerance,
            )
            self._latest = _Best(world_from_cam, points, cost)
        return self._latest


class _Best(NamedTuple):
    """Points (M, 3) at their best for poses (K, 4, 4), and what they cost."""

    world_from_cam: Floats
    points: Floats
    cost: float


def views_of(problem: WindowProblem, point_ok: Bools, config: SmoothingConfig) -> PointViews:
    """The observations of a window's points (M,) that are ok, by points."""
    return point_views(
        point_ok,
        problem.point,
        problem.keyframe,
        problem.xy,
        problem.disparity,
        problem.sigma_px,
        config.sigma_disparity_px,
        problem.intrinsics,
        problem.intrinsics[0] * problem.baseline_m,
        config.huber,
    )


@numba.njit(cache=True, nogil=True)
def _reduced(  # type: ignore[no-untyped-def]
    points,
    poses,
    slot,
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
    """Normal equations of the poses that may move and of the offset, the points eliminated."""
    free = slot.max() + 1
    # By blocks of 6 x 6, those on and above the diagonal: a block's rows lie side by side.
    blocks, gradient = np.zeros((free, free, 6, 6)), np.zeros((free + 1, 6))
    border = np.zeros((free + 1, 6))
    most = 0
    for m in range(len(starts) - 1):
        most = max(most, starts[m + 1] - starts[m])
    by_pose, by_point, error = np.zeros((3, 6)), np.zeros((3, 3)), np.zeros(3)
    coupling, lifted, at = np.zeros((most, 3, 6)), np.zeros((3, 6)), np.zeros(most, dtype=np.int64)
    normal, inverse, right, offset = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        if last == first:
            continue
        count = 0
        normal[:], right[:], offset[:] = 0.0, 0.0, 0.0
        for a in range(first, last):
            by_offset = _jacobians(
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
                error,
            )
            for p in range(3):
                u, v, d = by_point[0, p], by_point[1, p], by_point[2, p]
                right[p] += u * error[0] + v * error[1] + d * error[2]
                offset[p] += d * by_offset
                for q in range(3):
                    normal[p, q] += u * by_point[0, q] + v * by_point[1, q] + d * by_point[2, q]
            border[free, 0] += by_offset * by_offset
            gradient[free, 0] += by_offset * error[2]
            k = slot[keyframe[a]]
            if k < 0:
                continue
            at[count] = k
            _add_observation(by_pose, by_point, error, blocks[k, k], gradient[k], coupling[count])
            for c in range(6):
                border[k, c] += by_pose[2, c] * by_offset
            count += 1
        _invert(normal, inverse)
        _subtract_point(
            at[:count], coupling, lifted, inverse, right, offset, blocks, gradient, border
        )
    return _assembled(blocks, gradient, border)


@numba.njit(cache=True, nogil=True)
def _jacobians(  # type: ignore[no-untyped-def]
    at, pose, xy, disparity, s, intrinsics, fb, inverse_d, huber, by_pose, by_point, error
):
    """Fill an observation's derivatives and errors, weighted; gives that by the offset."""
    x = pose[0, 0] * at[0] + pose[0, 1] * at[1] + pose[0, 2] * at[2] + pose[0, 3]
    y = pose[1, 0] * at[0] + pose[1, 1] * at[1] + pose[1, 2] * at[2] + pose[1, 3]
    z = pose[2, 0] * at[0] + pose[2, 1] * at[1] + pose[2, 2] * at[2] + pose[2, 3]
    if z < _NEAREST:
        by_pose[:], by_point[:], error[:] = 0.0, 0.0, 0.0
        return 0.0
    eu = s * (intrinsics[0] * x / z + intrinsics[2] - xy[0])
    ev = s * (intrinsics[1] * y / z + intrinsics[3] - xy[1])
    measured = fb > 0.0 and not np.isnan(disparity)
    ed = inverse_d * (fb / z - disparity) if measured else 0.0
    t = inverse_d if measured else 0.0
    length = np.sqrt(eu * eu + ev * ev + ed * ed)
    weight = 1.0 if length <= huber else np.sqrt(huber / length)
    error[0], error[1], error[2] = weight * eu, weight * ev, weight * ed
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
    return weight * t


@numba.njit(cache=True, nogil=True)
def _add_observation(by_pose, by_point, error, block, gradient, coupling):  # type: ignore[no-untyped-def]
    for c in range(6):
        u, v, d = by_pose[0, c], by_pose[1, c], by_pose[2, c]
        gradient[c] += u * error[0] + v * error[1] + d * error[2]
        for e in range(6):
            block[c, e] += u * by_pose[0, e] + v * by_pose[1, e] + d * by_pose[2, e]
    for p in range(3):
        u, v, d = by_point[0, p], by_point[1, p], by_point[2, p]
        for c in range(6):
            coupling[p, c] = u * by_pose[0, c] + v * by_pose[1, c] + d * by_pose[2, c]


@numba.njit(cache=True, nogil=True)
def _subtract_point(  # type: ignore[no-untyped-def]
    at, coupling, lifted, inverse, right, offset, blocks, gradient, border
):
    """What poses and offset lose because the point may move too; `at` grows."""
    free = len(blocks)
    for p in range(3):
        shared = inverse[p, 0] * offset[0] + inverse[p, 1] * offset[1] + inverse[p, 2] * offset[2]
        border[free, 0] -= offset[p] * shared
        gradient[free, 0] -= right[p] * shared
    for a in range(len(at)):
        own = coupling[a]
        for p in range(3):
            i, j, k = inverse[p, 0], inverse[p, 1], inverse[p, 2]
            for c in range(6):
                lifted[p, c] = i * own[0, c] + j * own[1, c] + k * own[2, c]
        to, edge = gradient[at[a]], border[at[a]]
        for c in range(6):
            u, v, w = lifted[0, c], lifted[1, c], lifted[2, c]
            to[c] -= u * right[0] + v * right[1] + w * right[2]
            edge[c] -= u * offset[0] + v * offset[1] + w * offset[2]
        for b in range(a, len(at)):
            block, other = blocks[at[a], at[b]], coupling[b]
            for c in range(6):
                u, v, w = lifted[0, c], lifted[1, c], lifted[2, c]
                for e in range(6):
                    block[c, e] -= u * other[0, e] + v * other[1, e] + w * other[2, e]


@numba.njit(cache=True, nogil=True)
def _assembled(blocks, gradient, border):  # type: ignore[no-untyped-def]
    """Hessian (6 F + 1, 6 F + 1) and gradient (6 F + 1,), the offset last."""
    free = len(blocks)
    size = 6 * free + 1
    hessian, whole = np.zeros((size, size)), np.zeros(size)
    for r in range(size - 1):
        a, c = divmod(r, 6)
        whole[r] = gradient[a, c]
        hessian[r, size - 1] = hessian[size - 1, r] = border[a, c]
        for column in range(r, size - 1):
            b, e = divmod(column, 6)
            hessian[r, column] = hessian[column, r] = blocks[a, b, c, e]
    hessian[size - 1, size - 1], whole[size - 1] = border[free, 0], gradient[free, 0]
    return hessian, whole


@numba.njit(cache=True, nogil=True)
def _invert(m, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a point's (3, 3) normal matrix by cofactors.

    What no view tells of a point (its depth, without parallax) ties no poses together either: a
    trace of information in every direction makes the matrix regular and changes nothing else.
    """
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace == 0.0:
        inverse[:] = 0.0
        return
    for p in range(3):
        m[p, p] += _UNSEEN * trace
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    c01 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c02 = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    determinant = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = c00, c01, c02
    inverse[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    inverse[1, 2] = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    inverse[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    for p in range(3):
        for q in range(p, 3):
            inverse[p, q] /= determinant
            inverse[q, p] = inverse[p, q]
