"""Bundle adjustment seen by its poses alone: every point lies where its observations want it.

For given poses each point is put where its robust cost is least, so that the cost is a function of
the poses, and its normal equations are those of the window with the points eliminated. Points do
not depend on one another once the poses are given, which makes this a sum over points.

Source: Carlone et al., "Eliminating Conditionally Independent Sets in Factor Graphs", 2014 (smart
factors); Golub and Pereyra, "The Differentiation of Pseudo-Inverses", 1973 (variable projection).
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from vo.config import SmoothingConfig
from vo.types import Bools, Floats, WindowProblem

_SINGULAR = 1e-13  # determinant of a point's normal matrix against its trace cubed
_DAMPING = 1e-6  # of a point's step at first, against that trace
_LESS_BOLD = 30.0  # times the damping after a step that went too far
_BEHIND = 1e3  # standard deviations that an observation of a point behind the camera counts
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
        order = np.argsort(problem.point, kind="stable")
        order = order[point_ok[problem.point[order]]]
        self._points = np.ascontiguousarray(problem.points)
        self._latest: _Best | None = None
        starts = np.searchsorted(problem.point[order], np.arange(len(problem.points) + 1))
        self._observations = (
            starts,
            problem.keyframe[order],
            problem.xy[order],
            problem.disparity[order],
            1.0 / problem.sigma_px[order],
        )
        self._model = (
            np.array(problem.intrinsics),
            problem.intrinsics[0] * problem.baseline_m,
            1.0 / config.sigma_disparity_px,
            config.huber,
        )
        # Points must not be coarser than the poses, whose steps are judged by the cost.
        self._patience = (config.iterations, 0.1 * config.relative_error_tolerance)
        self._slot = np.where(problem.fixed, -1, np.cumsum(~problem.fixed) - 1)

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
        arrays = (_inverse(world_from_cam), self._slot, *self._observations, *self._model)
        hessian, gradient = _reduced(at.points, *arrays)
        return NormalEquations(hessian, gradient, at.cost)

    def _at(self, world_from_cam: Floats) -> _Best:
        """Optimisers ask for the same poses' cost first and their derivatives later."""
        if self._latest is None or not np.array_equal(world_from_cam, self._latest.world_from_cam):
            points = self._points.copy()
            arrays = (*self._patience, *self._observations, *self._model)
            cost = float(_refined(points, _inverse(world_from_cam), *arrays))
            self._latest = _Best(world_from_cam, points, cost)
        return self._latest


class _Best(NamedTuple):
    """Points (M, 3) at their best for poses (K, 4, 4), and what they cost."""

    world_from_cam: Floats
    points: Floats
    cost: float


def _inverse(world_from_cam: Floats) -> Floats:
    turned = world_from_cam[:, :3, :3].transpose(0, 2, 1)
    shift = -np.einsum("kij,kj->ki", turned, world_from_cam[:, :3, 3])
    return np.ascontiguousarray(np.concatenate([turned, shift[:, :, None]], axis=2))


@numba.njit(cache=True, nogil=True)
def _refined(  # type: ignore[no-untyped-def]
    points,
    poses,
    steps,
    tolerance,
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
    """Put every point where its cost is least, in place; gives the sum of the costs."""
    total = 0.0
    normal, right, inverse = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    damped, trial = np.zeros((3, 3)), np.zeros(3)
    trial_normal, trial_right = np.zeros((3, 3)), np.zeros(3)
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        if last == first:
            continue
        seen = (poses, keyframe[first:last], xy[first:last], disparity[first:last])
        scale = (inverse_sigma[first:last], intrinsics, fb, inverse_d, huber)
        cost = _point_normal(points[m], *seen, *scale, normal, right)
        damping = _DAMPING
        for _ in range(steps):
            damped[:] = normal
            trace = normal[0, 0] + normal[1, 1] + normal[2, 2]
            for p in range(3):
                damped[p, p] += damping * trace
            if not _invert(damped, inverse):
                break
            for p in range(3):
                trial[p] = points[m, p]
                for q in range(3):
                    trial[p] -= inverse[p, q] * right[q]
            lower = _point_normal(trial, *seen, *scale, trial_normal, trial_right)
            if not lower < cost:
                damping *= _LESS_BOLD
                continue
            settled = cost - lower < tolerance * cost
            points[m], normal[:], right[:] = trial, trial_normal, trial_right
            cost = lower
            damping /= _LESS_BOLD
            if settled:
                break
        total += cost
    return total


@numba.njit(cache=True, nogil=True)
def _point_normal(  # type: ignore[no-untyped-def]
    at,
    poses,
    keyframe,
    xy,
    disparity,
    inverse_sigma,
    intrinsics,
    fb,
    inverse_d,
    huber,
    normal,
    right,
):
    """Fill a point's normal matrix (3, 3) and gradient; gives its robust cost."""
    normal[:], right[:] = 0.0, 0.0
    cost = 0.0
    for a in range(len(keyframe)):
        pose = poses[keyframe[a]]
        x, y, z = _in_camera(pose, at)
        if z < _NEAREST:
            cost += huber * (_BEHIND - 0.5 * huber)
            continue
        eu, ev, ed, s, t = _errors(
            x, y, z, xy[a], disparity[a], inverse_sigma[a], intrinsics, fb, inverse_d
        )
        length = np.sqrt(eu * eu + ev * ev + ed * ed)
        weight = 1.0
        if length <= huber:
            cost += 0.5 * length * length
        else:
            cost += huber * (length - 0.5 * huber)
            weight = huber / length
        du, dv = s * intrinsics[0] / z, s * intrinsics[1] / z
        cu, cv, cd = -du * x / z, -dv * y / z, -t * fb / (z * z)
        for p in range(3):
            ju = du * pose[0, p] + cu * pose[2, p]
            jv = dv * pose[1, p] + cv * pose[2, p]
            jd = cd * pose[2, p]
            right[p] += weight * (ju * eu + jv * ev + jd * ed)
            for q in range(p + 1):
                ku = du * pose[0, q] + cu * pose[2, q]
                kv = dv * pose[1, q] + cv * pose[2, q]
                normal[p, q] += weight * (ju * ku + jv * kv + jd * cd * pose[2, q])
    normal[0, 1], normal[0, 2], normal[1, 2] = normal[1, 0], normal[2, 0], normal[2, 1]
    return cost


@numba.njit(cache=True, nogil=True)
def _in_camera(pose, at):  # type: ignore[no-untyped-def]
    x = pose[0, 0] * at[0] + pose[0, 1] * at[1] + pose[0, 2] * at[2] + pose[0, 3]
    y = pose[1, 0] * at[0] + pose[1, 1] * at[1] + pose[1, 2] * at[2] + pose[1, 3]
    z = pose[2, 0] * at[0] + pose[2, 1] * at[1] + pose[2, 2] * at[2] + pose[2, 3]
    return x, y, z


@numba.njit(cache=True, nogil=True)
def _errors(x, y, z, xy, disparity, s, intrinsics, fb, inverse_d):  # type: ignore[no-untyped-def]
    """Predicted - measured u, v, disparity in standard deviations, and 1 over the latter."""
    eu = s * (intrinsics[0] * x / z + intrinsics[2] - xy[0])
    ev = s * (intrinsics[1] * y / z + intrinsics[3] - xy[1])
    if fb > 0.0 and not np.isnan(disparity):
        return eu, ev, inverse_d * (fb / z - disparity), s, inverse_d
    return eu, ev, 0.0, s, 0.0


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
        seen = (poses, keyframe[first:last], xy[first:last], disparity[first:last])
        scale = (inverse_sigma[first:last], intrinsics, fb, inverse_d, huber)
        _point_normal(points[m], *seen, *scale, normal, right)
        if not _invert(normal, inverse):
            continue
        count = 0
        offset[:] = 0.0
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
                offset[p] += by_point[2, p] * by_offset
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
        _subtract_point(
            at[:count], coupling, lifted, inverse, right, offset, blocks, gradient, border
        )
    return _assembled(blocks, gradient, border)


@numba.njit(cache=True, nogil=True)
def _jacobians(  # type: ignore[no-untyped-def]
    at, pose, xy, disparity, s, intrinsics, fb, inverse_d, huber, by_pose, by_point, error
):
    """Fill an observation's derivatives and errors, weighted; gives that by the offset."""
    x, y, z = _in_camera(pose, at)
    if z < _NEAREST:
        by_pose[:], by_point[:], error[:] = 0.0, 0.0, 0.0
        return 0.0
    eu, ev, ed, s, t = _errors(x, y, z, xy, disparity, s, intrinsics, fb, inverse_d)
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
