"""Point refinement with fixed poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.geometry.projection import (
    MIN_DEPTH,
    Intrinsics,
    PixelObservations,
    by_world_axis,
    pixel,
    point_derivatives,
    to_camera,
)
from vo.base.types import Bools, Floats, Ints

# A (3, 3) normal matrix is singular if its determinant is at most this times its cubed trace.
SINGULAR = 1e-13
# Levenberg-Marquardt: initial damping relative to that trace, and the factor for it after a step
# that raises the cost; it is divided by the same factor after other steps.
_DAMPING, _DAMPING_FACTOR = 1e-6, 30.0
_COST_BEHIND = 1e3  # cost of a point behind one of its cameras


class PointViews(NamedTuple):
    """N observations of M points, ordered by point, and their weights.

    Attributes:
        starts: (M + 1,) first observation of each point.
        camera: (N,) row of the observing pose.
        xy: (N, 2) undistorted pixels.
        disparity: (N,) pixels, NaN where there is none.
        inverse_sigma: (N,) 1 over the standard deviation of xy.
        focal_baseline: fx * baseline in px m, 0 in mono.
        inverse_sigma_disparity: 1 over the standard deviation of a disparity.
        huber: residual, in standard deviations, from which an observation is weighted down.
        k1: of the lens whose ideal pixels `xy` are, where errors of the lens are estimated.
        k2: likewise.
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
    k1: float = 0.0
    k2: float = 0.0


def point_views(
    point_ok: Bools,
    point: Ints,
    camera: Ints,
    observed: PixelObservations,
    intrinsics: Intrinsics,
    focal_baseline: float,
    huber: float = 1.5,
) -> PointViews:
    """Order observations by point, without those of points (M,) that are not ok.

    N observations by rows of points and cameras; `focal_baseline` is fx * baseline in px m, 0 in
    mono; residuals above `huber` standard deviations weigh less.
    """
    starts, order = by_points(point_ok, point)
    return PointViews(
        starts,
        camera.take(order),
        observed.xy.take(order, axis=0),
        observed.disparity.take(order),
        1.0 / observed.sigma_px.take(order),
        intrinsics,
        focal_baseline,
        1.0 / observed.sigma_disparity_px,
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
    """Minimise the Huber-weighted errors of each point's observations with fixed poses.

    From `points` (M, 3) in the world, by at most `steps` of Levenberg and Marquardt each, until its
    cost decreases by less than `tolerance`, relative to it.

    Returns:
        Points (M, 3), and half the robust sum of squares of all observations. Points that cannot be
        improved, are behind one of their cameras, or have a single observation without disparity
        keep their position.
    """
    moved = points.copy()
    poses = np.ascontiguousarray(cam_from_world[:, :3])
    return moved, float(_refined(moved, poses, steps, tolerance, views))


@compiled
def by_points(point_ok, point):  # type: ignore[no-untyped-def]
    """`starts` (M + 1,), and rows of the observations of ok points, ordered by point (stable)."""
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
def _refined(points, poses, steps, tolerance, views):  # type: ignore[no-untyped-def]
    """Move every point to the minimum of its cost, in place; gives the sum of the costs."""
    starts, disparity, fb = views.starts, views.disparity, views.focal_baseline
    total = 0.0
    for m in range(len(starts) - 1):
        first, last = starts[m], starts[m + 1]
        if last == first:
            continue
        at = points[m, 0], points[m, 1], points[m, 2]
        cost, normal, right = _point_normal(at, first, last, poses, views)
        if not np.isfinite(cost):
            total += _COST_BEHIND
            continue
        if last - first == 1 and (fb == 0.0 or np.isnan(disparity[first])):
            total += cost
            continue  # a single view does not determine the depth
        damping = _DAMPING
        for _ in range(steps):
            solvable, trial = _stepped(at, normal, right, damping)
            if not solvable:
                break
            lower, trial_normal, trial_right = _point_normal(trial, first, last, poses, views)
            if not lower < cost:
                damping *= _DAMPING_FACTOR
                continue
            converged = cost - lower < tolerance * cost
            at, normal, right, cost = trial, trial_normal, trial_right, lower
            damping /= _DAMPING_FACTOR
            if converged:
                break
        points[m, 0], points[m, 1], points[m, 2] = at
        total += cost
    return total


@compiled(fastmath={"contract"}, **NO_REFCOUNT)
def _point_normal(at, first, last, poses, views):  # type: ignore[no-untyped-def]
    """Cost, normal matrix and gradient of a point, over its observations first to last - 1.

        cost = sum rho(|e|),    normal = sum w J^T J,    gradient = sum w J^T e,

    with e = (u, v, disparity), predicted - measured, in standard deviations, J = de/dpoint (3, 3),
    Huber's rho and w. The matrix is returned as xx, yy, zz, xy, xz, yz. Scalars throughout, which
    stay in registers. The cost is infinite if the point is behind one of the cameras.
    """
    _, camera, xy, disparity, inverse_sigma, intrinsics, fb, inverse_d, huber, _, _ = views
    cost = 0.0
    n00 = n11 = n22 = n10 = n20 = n21 = 0.0
    r0 = r1 = r2 = 0.0
    for a in range(np.uintp(first), np.uintp(last)):
        pose = poses[np.uintp(camera[a])]
        x, y, z = to_camera(pose, at[0], at[1], at[2])
        if z < MIN_DEPTH:
            return np.inf, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        # A single division, as it is the slowest operation.
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
    """Whether the damped normal matrix is regular, and the point after its step.

    The (3, 3) matrix is inverted by cofactors; i00 to i22 are elements of the inverse.
    """
    xx, yy, zz, xy, xz, yz = normal
    added = damping * (xx + yy + zz)
    xx, yy, zz = xx + added, yy + added, zz + added
    c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * c00 + xy * c01 + xz * c02
    trace = xx + yy + zz
    if not determinant > SINGULAR * trace * trace * trace:
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
