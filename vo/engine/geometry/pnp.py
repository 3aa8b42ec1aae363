"""Robust refinement of a camera's pose from known points."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.geometry.projection import (
    MIN_DEPTH,
    Intrinsics,
    PixelObservations,
    by_cam_from_world,
    pixel,
    to_camera,
)
from vo.base.geometry.transforms import orthonormalised
from vo.base.types import Bools, Floats

# Squared Mahalanobis length of a step below which the iteration has converged.
_CONVERGED = 1e-6
_MAX_ITERATIONS = 12  # Gauss-Newton
_HUBER = 2.0  # residual, in standard deviations, from which a match is weighted down


class PoseFit(NamedTuple):
    """A refined pose.

    Attributes:
        cam_from_world: (4, 4).
        inlier: (N,) observations within the gate.
        residual: (N,) length of the residual in standard deviations, infinite behind the camera.
        information: (6, 6) J^T W J of the inliers; tangent xi = (rx ry rz tx ty tz) of
            exp(xi) @ cam_from_world.
    """

    cam_from_world: Floats
    inlier: Bools
    residual: Floats
    information: Floats


def refine_pose(
    cam_from_world: Floats,
    points: Floats,
    observed: PixelObservations,
    intrinsics: Intrinsics,
    focal_baseline: float,
    *,
    gate: float = 3.5,
) -> PoseFit:
    """Minimise Huber-weighted reprojection (and disparity) errors over the pose.

    First with all observations, then, after convergence or half of the iterations, without
    outliers.

    `focal_baseline` is fx * baseline in px m, 0 in mono; outliers are above `gate` standard
    deviations.

    Source: Huber, "Robust Estimation of a Location Parameter", 1964; the two-stage rejection
        follows Mur-Artal et al., "ORB-SLAM", 2015, sec. V.
    """
    transform, residual, information = _gauss_newton(
        np.ascontiguousarray(cam_from_world),
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(observed.xy, dtype=np.float64),
        np.ascontiguousarray(observed.disparity, dtype=np.float64),
        np.ascontiguousarray(observed.sigma_px, dtype=np.float64),
        observed.sigma_disparity_px,
        intrinsics,
        focal_baseline,
        _HUBER,
        gate,
        _MAX_ITERATIONS,
    )
    return PoseFit(orthonormalised(transform), residual < gate, residual, information)


@compiled
def take_step(h: Any, b: Any, transform: Any) -> Any:
    """One Gauss-Newton step xi = h^-1 b of a pose, to exp(xi) @ transform.

    Args:
        h: (6, 6) J^T W J, tangent (rx ry rz tx ty tz). If it is not positive definite, xi is 0.
        b: (6,) -J^T W e.
        transform: (4, 4) cam_from_world.

    Returns:
        The new transform, and the squared Mahalanobis length xi^T h xi of the step.
    """
    change = _solve(h, b)
    return _product(_exp(change), transform), _inner(change, b)


@compiled
def _gauss_newton(  # type: ignore[no-untyped-def]
    start, points, xy, disparity, sigma, sigma_d, intrinsics, fb, huber, gate, iterations
):
    """Iterate from `start`; gives the transform, residuals (N,) and information (6, 6)."""
    transform = start.copy()
    residual = np.full(len(points), np.inf)
    rows = np.zeros((7, 3 * len(points)))
    limit = np.inf
    for step in range(iterations + 1):
        _weigh(
            *(transform, points, xy, disparity, sigma, sigma_d, intrinsics, fb, huber, limit),
            *(rows, residual),
        )
        h, b = _normal_equations(rows)
        if step == iterations:
            break
        information = h.copy()
        for m in range(6):  # slightly damped, so that too few points do not make it singular
            h[m, m] += 1e-9 + 1e-9 * h[m, m]
        change = _solve(h, b)
        converged = _inner(change, b) < _CONVERGED
        if converged and limit == gate:
            return transform, residual, information
        if converged or step == iterations // 2:
            limit = gate
        transform = _product(_exp(change), transform)
    return transform, residual, h


@compiled(**NO_REFCOUNT)
def _weigh(  # type: ignore[no-untyped-def]
    t, points, xy, disparity, sigma, sigma_d, intrinsics, fb, huber, limit, rows, residual
):
    """Fill `rows` (7, 3 N) with weighted J^T and, in the last row, weighted errors.

    Columns 3 i to 3 i + 2 belong to u, v and disparity of observation i. In this layout J^T J
    and J^T e are scalar products of contiguous rows, which become vector instructions.
    Observations behind the camera, or with residuals of `limit` or more, have weight 0.
    """
    for i in range(len(points)):
        x, y, z = to_camera(t, points[i, 0], points[i, 1], points[i, 2])
        k = 3 * i
        if z < MIN_DEPTH:
            residual[i] = np.inf
            for m in range(7):
                rows[m, k], rows[m, k + 1], rows[m, k + 2] = 0.0, 0.0, 0.0
            continue
        iz = 1.0 / z
        x *= iz
        y *= iz
        iu = 1.0 / sigma[i]
        u, v = pixel(intrinsics, x, y, 1.0)
        ex, ey, ed = (u - xy[i, 0]) * iu, (v - xy[i, 1]) * iu, 0.0
        su, sv, sd = intrinsics.fx * iu, intrinsics.fy * iu, 0.0
        if fb > 0.0 and not np.isnan(disparity[i]):
            ed = (fb * iz - disparity[i]) / sigma_d
            sd = -fb * iz / sigma_d
        r = np.sqrt(ex * ex + ey * ey + ed * ed)
        residual[i] = r
        weight = 0.0 if r >= limit else 1.0 if r < huber else np.sqrt(huber / r)
        su, sv, sd = su * weight, sv * weight, sd * weight
        by_u, by_v = by_cam_from_world(su, sv, x, y, iz)
        for m in range(6):
            rows[m, k], rows[m, k + 1] = by_u[m], by_v[m]
        # Disparity, with sd = z dd/dz: a rotation moves p by r x p, whose z is (rx y - ry x) z.
        rows[0, k + 2], rows[1, k + 2], rows[5, k + 2] = sd * y, -sd * x, sd * iz
        rows[6, k], rows[6, k + 1], rows[6, k + 2] = ex * weight, ey * weight, ed * weight


@compiled
def _normal_equations(rows):  # type: ignore[no-untyped-def]
    """J^T J (6, 6) and -J^T e (6,) of `rows` as in `_weigh`."""
    h, b = np.empty((6, 6)), np.empty(6)
    for m in range(6):
        b[m] = -_dot(rows[m], rows[6])
        for n in range(m, 6):
            h[m, n] = h[n, m] = _dot(rows[m], rows[n])
    return h, b


@compiled(fastmath={"reassoc", "contract"}, **NO_REFCOUNT)
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@compiled(**NO_REFCOUNT)
def _inner(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@compiled
def _exp(xi):  # type: ignore[no-untyped-def]
    """Rotation by Rodrigues' formula, translation unchanged: exp(xi) to first order.

    The iteration converges to the same pose as with the exact exponential map.
    """
    angle = np.sqrt(xi[0] ** 2 + xi[1] ** 2 + xi[2] ** 2)
    k = np.zeros((3, 3))
    k[0, 1], k[0, 2], k[1, 2] = -xi[2], xi[1], -xi[0]
    k[1, 0], k[2, 0], k[2, 1] = xi[2], -xi[1], xi[0]
    result = np.zeros((4, 4))
    for i in range(4):
        result[i, i] = 1.0
    if angle > 1e-12:
        a = np.sin(angle) / angle
        c = (1.0 - np.cos(angle)) / (angle * angle)
        kk = _product(k, k)
        for i in range(3):
            for j in range(3):
                result[i, j] += a * k[i, j] + c * kk[i, j]
    result[0, 3], result[1, 3], result[2, 3] = xi[3], xi[4], xi[5]
    return result


# numba's own `@` and `np.linalg` need scipy, which is not installed with this package.
@compiled
def _product(a, b):  # type: ignore[no-untyped-def]
    result = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for m in range(b.shape[1]):
                result[i, m] += a[i, k] * b[k, m]
    return result


@compiled
def _solve(h, b):  # type: ignore[no-untyped-def]
    """Solve h x = b by Cholesky; zeros if h is not positive definite."""
    n = len(b)
    low = np.zeros((n, n))
    x = b.copy()
    for i in range(n):
        for j in range(i + 1):
            rest = h[i, j]
            for k in range(j):
                rest -= low[i, k] * low[j, k]
            if i > j:
                low[i, j] = rest / low[j, j]
            elif rest > 0.0:
                low[i, i] = np.sqrt(rest)
            else:
                return np.zeros(n)
    for i in range(n):
        for k in range(i):
            x[i] -= low[i, k] * x[k]
        x[i] /= low[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= low[k, i] * x[k]
        x[i] /= low[i, i]
    return x
