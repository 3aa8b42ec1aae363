"""Points seen from known poses: each put where its observations want it."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from vo.types import Bools, Floats, Ints

_SINGULAR = 1e-13  # determinant of a point's normal matrix against its trace cubed
_DAMPING = 1e-6  # of a point's step at first, against that trace
_LESS_BOLD = 30.0  # times the damping after a step that went too far
_BEHIND = 1e3  # what a point behind one of its cameras costs
_NEAREST = 1e-6  # depth from which on a point is in front


class PointViews(NamedTuple):
    """N observations of M points, those of a point side by side, and how they are weighed.

    Attributes:
        starts: (M + 1,) first observation of each point.
        camera: (N,) row of the pose it was made from.
        xy: (N, 2) ideal pixels.
        disparity: (N,) pixels, NaN where there is none.
        inverse_sigma: (N,) 1 over the standard deviation of xy.
        intrinsics: (4,) fx, fy, cx, cy.
        focal_baseline: fx * baseline, 0 in mono.
        inverse_sigma_disparity: 1 over the standard deviation of a disparity.
        huber: residual, in standard deviations, from which an observation counts less.
    """

    starts: Ints
    camera: Ints
    xy: Floats
    disparity: Floats
    inverse_sigma: Floats
    intrinsics: Floats
    focal_baseline: float
    inverse_sigma_disparity: float
    huber: float


def point_views(
    point_ok: Bools,
    point: Ints,
    camera: Ints,
    xy: Floats,
    disparity: Floats,
    sigma_px: Floats,
    sigma_disparity_px: float,
    intrinsics: tuple[float, float, float, float],
    focal_baseline: float,
    huber: float = 1.5,
) -> PointViews:
    """Order observations by their points; those of points (M,) that are not ok are left out.

    Args:
        point_ok: (M,).
        point: (N,) row of the point of each observation.
        camera: (N,) row of its pose.
        xy: (N, 2) ideal pixels.
        disparity: (N,) pixels, NaN where there is none.
        sigma_px: (N,) standard deviation of xy.
        sigma_disparity_px: standard deviation of disparity.
        intrinsics: fx, fy, cx, cy.
        focal_baseline: fx * baseline, 0 in mono.
        huber: residual, in standard deviations, from which an observation counts less.
    """
    starts, order = _by_points(point_ok, point)
    return PointViews(
        starts,
        camera.take(order),
        xy.take(order, axis=0),
        disparity.take(order),
        1.0 / sigma_px.take(order),
        np.array(intrinsics),
        focal_baseline,
        1.0 / sigma_disparity_px,
        huber,
    )


def best_points(
    points: Floats,
    cam_from_world: Floats,
    views: PointViews,
    *,
    steps: int = 8,
    tolerance: float = 1e-3,
) -> tuple[Floats, float]:
    """Minimise the Huber-weighted errors of each point's observations, the poses held.

    Args:
        points: (M, 3) first guess, in the world.
        cam_from_world: (K, 4, 4), or (K, 3, 4).
        views: what was seen.
        steps: most Levenberg-Marquardt steps of a point.
        tolerance: relative decrease of a point's cost below which it stays.

    Returns:
        (M, 3), and half the robust sum of squares of all observations; a point that cannot be
        improved, is behind one of its cameras, or is seen by a single one without disparity stays
        where it was.
    """
    moved = points.copy()
    poses = np.ascontiguousarray(cam_from_world[:, :3])
    return moved, float(_refined(moved, poses, steps, tolerance, *views))


@numba.njit(cache=True, nogil=True)
def _by_points(point_ok, point):  # type: ignore[no-untyped-def]
    """First observation (M + 1,) of each point that is ok, and rows of theirs in that order."""
    starts = np.zeros(len(point_ok) + 1, dtype=np.int64)
    for m in point:
        starts[m + 1] += point_ok[m]
    for m in range(len(point_ok)):
        starts[m + 1] += starts[m]
    order = np.empty(starts[-1], dtype=np.int64)
    end = starts[:-1].copy()
    for n in range(len(point)):
        m = point[n]
        if point_ok[m]:
            order[end[m]] = n
            end[m] += 1
    return starts, order


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
        if not np.isfinite(cost):
            total += _BEHIND
            continue
        if last - first == 1 and (fb == 0.0 or np.isnan(disparity[first])):
            total += cost
            continue  # a single view does not tell the depth
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
    """Fill a point's normal matrix (3, 3) and gradient; gives its robust cost, inf if behind."""
    normal[:], right[:] = 0.0, 0.0
    cost = 0.0
    for a in range(len(keyframe)):
        pose = poses[keyframe[a]]
        x, y, z = _in_camera(pose, at)
        if z < _NEAREST:
            return np.inf
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
