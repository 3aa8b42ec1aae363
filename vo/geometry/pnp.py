"""A camera's pose from known points: robust refinement of the pose alone."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from vo.geometry.transforms import orthonormalised
from vo.types import Bools, Floats


class PoseFit(NamedTuple):
    """A refined pose.

    Attributes:
        cam_from_world: (4, 4).
        inlier: (N,) observations within the gate.
        residual: (N,) length of the weighted residual, in standard deviations.
        information: (6, 6) J^T W J of the inliers, tangent (rx ry rz tx ty tz) in the camera.
    """

    cam_from_world: Floats
    inlier: Bools
    residual: Floats
    information: Floats


def refine_pose(
    cam_from_world: Floats,
    points: Floats,
    xy: Floats,
    disparity: Floats,
    sigma_px: Floats,
    sigma_disparity_px: float,
    intrinsics: tuple[float, float, float, float],
    focal_baseline: float,
    *,
    huber: float = 2.0,
    gate: float = 3.5,
    iterations: int = 12,
) -> PoseFit:
    """Minimise Huber-weighted reprojection (and disparity) errors over the pose.

    Args:
        cam_from_world: (4, 4) first guess.
        points: (N, 3) in the world.
        xy: (N, 2) ideal pixels.
        disparity: (N,) u_left - u_right in pixels, NaN where there is no right match.
        sigma_px: (N,) standard deviation of xy.
        sigma_disparity_px: standard deviation of disparity.
        intrinsics: fx, fy, cx, cy.
        focal_baseline: fx * baseline, 0 in mono.
        huber: residual, in standard deviations, from which a match counts less.
        gate: residual from which a match counts nothing in the second half and as an outlier.
        iterations: Gauss-Newton steps.

    Source: Huber 1964; the two-stage rejection follows Mur-Artal 2015, sec. V.
    """
    transform, residual, information = _gauss_newton(
        np.ascontiguousarray(cam_from_world),
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(xy, dtype=np.float64),
        np.ascontiguousarray(disparity, dtype=np.float64),
        np.ascontiguousarray(sigma_px, dtype=np.float64),
        sigma_disparity_px,
        np.array(intrinsics),
        focal_baseline,
        huber,
        gate,
        iterations,
    )
    return PoseFit(orthonormalised(transform), residual < gate, residual, information)


@numba.njit(cache=True, nogil=True)
def _gauss_newton(  # type: ignore[no-untyped-def]
    start, points, xy, disparity, sigma, sigma_d, intrinsics, fb, huber, gate, iterations
):
    fx, fy, cx, cy = intrinsics
    transform = start.copy()
    count = len(points)
    residual = np.full(count, np.inf)
    information = np.zeros((6, 6))
    j = np.zeros((3, 6))
    e = np.zeros(3)
    for step in range(iterations + 1):
        h = np.zeros((6, 6))
        b = np.zeros(6)
        for i in range(count):
            p = points[i]
            x = transform[0, 0] * p[0] + transform[0, 1] * p[1] + transform[0, 2] * p[2]
            y = transform[1, 0] * p[0] + transform[1, 1] * p[1] + transform[1, 2] * p[2]
            z = transform[2, 0] * p[0] + transform[2, 1] * p[1] + transform[2, 2] * p[2]
            x += transform[0, 3]
            y += transform[1, 3]
            z += transform[2, 3]
            if z < 1e-6:
                residual[i] = np.inf
                continue
            iz = 1.0 / z
            e[0] = (fx * x * iz + cx - xy[i, 0]) / sigma[i]
            e[1] = (fy * y * iz + cy - xy[i, 1]) / sigma[i]
            rows = 2
            if fb > 0.0 and not np.isnan(disparity[i]):
                e[2] = (fb * iz - disparity[i]) / sigma_d
                rows = 3
            square = e[0] * e[0] + e[1] * e[1]
            if rows == 3:
                square += e[2] * e[2]
            r = np.sqrt(square)
            residual[i] = r
            if step > iterations // 2 and r >= gate:
                continue
            weight = 1.0 if r < huber else huber / r
            # Derivative by a motion of the camera's own frame: p' = exp(xi) p.
            j[0, 0] = -fx * x * y * iz * iz / sigma[i]
            j[0, 1] = fx * (1.0 + x * x * iz * iz) / sigma[i]
            j[0, 2] = -fx * y * iz / sigma[i]
            j[0, 3] = fx * iz / sigma[i]
            j[0, 4] = 0.0
            j[0, 5] = -fx * x * iz * iz / sigma[i]
            j[1, 0] = -fy * (1.0 + y * y * iz * iz) / sigma[i]
            j[1, 1] = fy * x * y * iz * iz / sigma[i]
            j[1, 2] = fy * x * iz / sigma[i]
            j[1, 3] = 0.0
            j[1, 4] = fy * iz / sigma[i]
            j[1, 5] = -fy * y * iz * iz / sigma[i]
            j[2, 0] = -fb * y * iz * iz / sigma_d
            j[2, 1] = fb * x * iz * iz / sigma_d
            j[2, 2] = 0.0
            j[2, 3] = 0.0
            j[2, 4] = 0.0
            j[2, 5] = -fb * iz * iz / sigma_d
            for k in range(rows):
                for m in range(6):
                    b[m] -= weight * j[k, m] * e[k]
                    for n in range(m, 6):
                        h[m, n] += weight * j[k, m] * j[k, n]
        for m in range(6):
            for n in range(m):
                h[m, n] = h[n, m]
        if step == iterations:
            information = h
            break
        for m in range(6):
            h[m, m] += 1e-9 + 1e-9 * h[m, m]
        transform = _product(_exp(_solve(h, b)), transform)
    return transform, residual, information


@numba.njit(cache=True, nogil=True)
def _exp(xi):  # type: ignore[no-untyped-def]
    """First the rotation (Rodrigues), then the translation as it is: enough for small steps."""
    angle = np.sqrt(xi[0] ** 2 + xi[1] ** 2 + xi[2] ** 2)
    k = np.zeros((3, 3))
    k[0, 1], k[0, 2], k[1, 2] = -xi[2], xi[1], -xi[0]
    k[1, 0], k[2, 0], k[2, 1] = xi[2], -xi[1], xi[0]
    result = np.eye(4)
    if angle > 1e-12:
        a = np.sin(angle) / angle
        c = (1.0 - np.cos(angle)) / (angle * angle)
        result[:3, :3] += a * k + c * _product(k, k)
    result[0, 3], result[1, 3], result[2, 3] = xi[3], xi[4], xi[5]
    return result


# numba's own `@` and `np.linalg` need scipy, which is not installed with this package.
@numba.njit(cache=True, nogil=True)
def _product(a, b):  # type: ignore[no-untyped-def]
    result = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for m in range(b.shape[1]):
                result[i, m] += a[i, k] * b[k, m]
    return result


@numba.njit(cache=True, nogil=True)
def _solve(h, b):  # type: ignore[no-untyped-def]
    """X of h x = b for a symmetric positive definite h (Cholesky); zeros where it is not."""
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
