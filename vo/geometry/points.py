"""Points seen from known poses: each put where its observations want it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.compiling.function import NO_REFCOUNT, compiled
from vo.geometry.projection import (
    MIN_DEPTH,
    Intrinsics,
    by_world_axis,
    pixel,
    point_derivatives,
    to_camera,
)
from vo.types import Bools, Floats, Ints

_SINGULAR = 1e-13  # determinant of a point's normal matrix against its trace cubed
_DAMPING = 1e-6  # of a point's step at first, against that trace
_LESS_BOLD = 30.0  # times the damping after a step that went too far
_BEHIND = 1e3  # what a point behind one of its cameras costs


class PointViews(NamedTuple):
    """N observations of M points, those of a point side by side, and how they are weighed.

    Attributes:
        starts: (M + 1,) first observation of each point.
        camera: (N,) row of the pose it was made from.
        xy: (N, 2) ideal pixels.
        disparity: (N,) pixels, NaN where there is none.
        inverse_sigma: (N,) 1 over the standard deviation of xy.
        intrinsics: of all cameras.
        focal_baseline: fx * baseline, 0 in mono.
        inverse_sigma_disparity: 1 over the standard deviation of a disparity.
        huber: residual, in standard deviations, from which an observation counts less.
    """

    starts: Ints
    camera: Ints
    xy: Floats
    disparity: Floats
    inverse_sigma: Floats
    intrinsics: Intrinsics
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
    intrinsics: Intrinsics,
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
        intrinsics: of all cameras.
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
        intrinsics,
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


@compiled
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


@compiled(fastmath={"contract"})
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
    views = (poses, keyframe, xy, disparity, inverse_sigma, intrinsics, fb, inverse_d, huber)
    total = 0.0
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        if last == first:
            continue
        at = points[m, 0], points[m, 1], points[m, 2]
        cost, normal, right = _point_normal(at, first, last, views)
        if not np.isfinite(cost):
            total += _BEHIND
            continue
        if last - first == 1 and (fb == 0.0 or np.isnan(disparity[first])):
            total += cost
            continue  # a single view does not tell the depth
        damping = _DAMPING
        for _ in range(steps):
            solvable, trial = _stepped(at, normal, right, damping)
            if not solvable:
                break
            lower, trial_normal, trial_right = _point_normal(trial, first, last, views)
            if not lower < cost:
                damping *= _LESS_BOLD
                continue
            settled = cost - lower < tolerance * cost
            at, normal, right, cost = trial, trial_normal, trial_right, lower
            damping /= _LESS_BOLD
            if settled:
                break
        points[m, 0], points[m, 1], points[m, 2] = at
        total += cost
    return total


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _point_normal(at, first, last, views):  # type: ignore[no-untyped-def]
    """A point's robust cost, inf if behind, its normal matrix (00 11 22 10 20 21) and gradient."""
    poses, keyframe, xy, disparity, inverse_sigma, intrinsics, fb, inverse_d, huber = views
    cost = 0.0
    n00 = n11 = n22 = n10 = n20 = n21 = 0.0
    r0 = r1 = r2 = 0.0
    for a in range(first, last):
        pose = poses[keyframe[a]]
        x, y, z = to_camera(pose, at[0], at[1], at[2])
        if z < MIN_DEPTH:
            return np.inf, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        # Predicted - measured u, v, disparity in standard deviations. One division serves all.
        s, t, ed, near = inverse_sigma[a], 0.0, 0.0, 1.0 / z
        x, y = x * near, y * near
        u, v = pixel(intrinsics, x, y, 1.0)
        eu, ev = s * (u - xy[a, 0]), s * (v - xy[a, 1])
        if fb > 0.0 and not np.isnan(disparity[a]):
            t, ed = inverse_d, inverse_d * (fb * near - disparity[a])
        length = np.sqrt(eu * eu + ev * ev + ed * ed)
        weight = 1.0
        if length <= huber:
            cost += 0.5 * length * length
        else:
            cost += huber * (length - 0.5 * huber)
            weight = huber / length
        by_point = point_derivatives(s * intrinsics.fx, s * intrinsics.fy, t * fb, x, y, 1.0, near)
        u0, v0, d0 = by_world_axis(by_point, pose[0, 0], pose[1, 0], pose[2, 0])
        u1, v1, d1 = by_world_axis(by_point, pose[0, 1], pose[1, 1], pose[2, 1])
        u2, v2, d2 = by_world_axis(by_point, pose[0, 2], pose[1, 2], pose[2, 2])
        r0 += weight * (u0 * eu + v0 * ev + d0 * ed)
        r1 += weight * (u1 * eu + v1 * ev + d1 * ed)
        r2 += weight * (u2 * eu + v2 * ev + d2 * ed)
        n00 += weight * (u0 * u0 + v0 * v0 + d0 * by_point[4] * pose[2, 0])
        n11 += weight * (u1 * u1 + v1 * v1 + d1 * by_point[4] * pose[2, 1])
        n22 += weight * (u2 * u2 + v2 * v2 + d2 * by_point[4] * pose[2, 2])
        n10 += weight * (u1 * u0 + v1 * v0 + d1 * by_point[4] * pose[2, 0])
        n20 += weight * (u2 * u0 + v2 * v0 + d2 * by_point[4] * pose[2, 0])
        n21 += weight * (u2 * u1 + v2 * v1 + d2 * by_point[4] * pose[2, 1])
    return cost, (n00, n11, n22, n10, n20, n21), (r0, r1, r2)


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _stepped(at, normal, right, damping):  # type: ignore[no-untyped-def]
    """Whether the damped normal matrix is regular, and where its step, by cofactors, leads."""
    xx, yy, zz, xy, xz, yz = normal
    added = damping * (xx + yy + zz)
    xx, yy, zz = xx + added, yy + added, zz + added
    c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * c00 + xy * c01 + xz * c02
    trace = xx + yy + zz
    if not determinant > _SINGULAR * trace * trace * trace:
        return False, at
    i00, i01, i02 = c00 / determinant, c01 / determinant, c02 / determinant
    i11 = (xx * zz - xz * xz) / determinant
    i12 = (xy * xz - xx * yz) / determinant
    i22 = (xx * yy - xy * xy) / determinant
    return True, (
        at[0] - i00 * right[0] - i01 * right[1] - i02 * right[2],
        at[1] - i01 * right[0] - i11 * right[1] - i12 * right[2],
        at[2] - i02 * right[0] - i12 * right[1] - i22 * right[2],
    )
