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

    Attributes:
        hessian: (6 F, 6 F).
        gradient: (6 F,).
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
        self._points = problem.points.copy()
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
        return self._refine(self._points.copy(), _inverse(world_from_cam))

    def points_for(self, world_from_cam: Floats) -> Floats:
        """(M, 3) points at their best for poses (K, 4, 4)."""
        points = self._points.copy()
        self._refine(points, _inverse(world_from_cam))
        return points

    def normal_equations(self, world_from_cam: Floats) -> NormalEquations:
        """Move every point to its best for poses (K, 4, 4), and linearise there."""
        cam_from_world = _inverse(world_from_cam)
        cost = self._refine(self._points, cam_from_world)
        arrays = (self._slot, *self._observations, *self._model)
        hessian, gradient = _reduced(self._points, cam_from_world, *arrays)
        return NormalEquations(hessian, gradient, cost)

    def _refine(self, points: Floats, cam_from_world: Floats) -> float:
        arrays = (*self._observations, *self._model)
        return float(_refined(points, cam_from_world, *self._patience, *arrays))


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
    """Normal equations of the poses that may move, the points eliminated (Schur complement)."""
    size = 6 * (slot.max() + 1)
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    most = 0
    for m in range(len(starts) - 1):
        most = max(most, starts[m + 1] - starts[m])
    by_pose, by_point, error = np.zeros((3, 6)), np.zeros((3, 3)), np.zeros(3)
    coupling, rows = np.zeros((most, 3, 6)), np.zeros(most, dtype=np.int64)
    normal, inverse, right = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
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
        for a in range(first, last):
            row = 6 * slot[keyframe[a]]
            if row < 0:
                continue
            if _jacobians(
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
            ):
                _add_observation(row, by_pose, by_point, error, hessian, gradient, coupling[count])
                rows[count] = row
                count += 1
        _subtract_point(rows[:count], coupling, inverse, right, hessian, gradient)
    for r in range(size):
        for c in range(r):
            hessian[r, c] = hessian[c, r]
    return hessian, gradient


@numba.njit(cache=True, nogil=True)
def _jacobians(  # type: ignore[no-untyped-def]
    at, pose, xy, disparity, s, intrinsics, fb, inverse_d, huber, by_pose, by_point, error
):
    """Fill an observation's derivatives and errors, weighted; False if it has none."""
    x, y, z = _in_camera(pose, at)
    if z < _NEAREST:
        return False
    eu, ev, ed, s, t = _errors(x, y, z, xy, disparity, s, intrinsics, fb, inverse_d)
    length = np.sqrt(eu * eu + ev * ev + ed * ed)
    weight = 1.0 if length <= huber else np.sqrt(huber / length)
    error[0], error[1], error[2] = weight * eu, weight * ev, weight * ed
    du, dv = weight * s * intrinsics[0] / z, weight * s * intrinsics[1] / z
    cd = -weight * t * fb / (z * z)
    for r in range(3):
        a = du if r == 0 else 0.0
        b = dv if r == 1 else 0.0
        c = cd
        if r == 0:
            c = -du * x / z
        elif r == 1:
            c = -dv * y / z
        for p in range(3):
            by_point[r, p] = a * pose[0, p] + b * pose[1, p] + c * pose[2, p]
        # A motion exp(xi) of the camera's own frame moves a point in it by -(rho + phi x p).
        by_pose[r, 0] = b * z - c * y
        by_pose[r, 1] = c * x - a * z
        by_pose[r, 2] = a * y - b * x
        by_pose[r, 3], by_pose[r, 4], by_pose[r, 5] = -a, -b, -c
    return True


@numba.njit(cache=True, nogil=True)
def _add_observation(  # type: ignore[no-untyped-def]
    row, by_pose, by_point, error, hessian, gradient, coupling
):
    for c in range(6):
        total = 0.0
        for r in range(3):
            total += by_pose[r, c] * error[r]
        gradient[row + c] += total
        for d in range(c, 6):
            total = 0.0
            for r in range(3):
                total += by_pose[r, c] * by_pose[r, d]
            hessian[row + c, row + d] += total
        for p in range(3):
            total = 0.0
            for r in range(3):
                total += by_point[r, p] * by_pose[r, c]
            coupling[p, c] = total


@numba.njit(cache=True, nogil=True)
def _subtract_point(rows, coupling, inverse, right, hessian, gradient):  # type: ignore[no-untyped-def]
    """What the poses lose because the point may move too; rows grow from one to the next."""
    lifted = np.zeros((3, 6))
    for a in range(len(rows)):
        for p in range(3):
            for c in range(6):
                total = 0.0
                for q in range(3):
                    total += inverse[p, q] * coupling[a, q, c]
                lifted[p, c] = total
        for c in range(6):
            for p in range(3):
                gradient[rows[a] + c] -= lifted[p, c] * right[p]
        for b in range(a, len(rows)):
            for c in range(6):
                for d in range(6):
                    total = 0.0
                    for p in range(3):
                        total += lifted[p, c] * coupling[b, p, d]
                    hessian[rows[a] + c, rows[b] + d] -= total


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
