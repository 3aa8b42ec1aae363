"""Points seen from known poses: each refined on its own."""

from __future__ import annotations

import numba
import numpy as np

from vo.types import Floats, Ints


def refine_points(
    points: Floats,
    cam_from_world: Floats,
    point: Ints,
    camera: Ints,
    xy: Floats,
    disparity: Floats,
    sigma_px: Floats,
    sigma_disparity_px: float,
    intrinsics: tuple[float, float, float, float],
    focal_baseline: float,
    *,
    huber: float = 1.5,
    iterations: int = 6,
) -> Floats:
    """Minimise the Huber-weighted errors of each point's observations, the poses held.

    Args:
        points: (M, 3) first guess, in the world.
        cam_from_world: (K, 4, 4).
        point: (N,) row in points of each observation.
        camera: (N,) row in cam_from_world of each observation.
        xy: (N, 2) ideal pixels.
        disparity: (N,) pixels, NaN where there is none.
        sigma_px: (N,) standard deviation of xy.
        sigma_disparity_px: standard deviation of disparity.
        intrinsics: fx, fy, cx, cy.
        focal_baseline: fx * baseline, 0 in mono.
        huber: residual, in standard deviations, from which an observation counts less.
        iterations: Levenberg-Marquardt steps.

    Returns:
        (M, 3); a point that cannot be improved, is behind one of its cameras, or is seen by a
        single camera without disparity stays where it was.
    """
    order = np.argsort(point, kind="stable")
    starts = np.searchsorted(point[order], np.arange(len(points) + 1))
    return np.asarray(
        _refine(
            np.ascontiguousarray(points),
            np.ascontiguousarray(cam_from_world),
            order,
            starts,
            camera,
            np.ascontiguousarray(xy),
            disparity,
            sigma_px,
            sigma_disparity_px,
            np.array(intrinsics),
            focal_baseline,
            huber,
            iterations,
        )
    )


@numba.njit(cache=True, nogil=True)
def _refine(  # type: ignore[no-untyped-def]
    points,
    poses,
    order,
    starts,
    camera,
    xy,
    disparity,
    sigma,
    sigma_d,
    intrinsics,
    fb,
    huber,
    iterations,
):
    result = points.copy()
    h = np.zeros((3, 3))
    b = np.zeros(3)
    for m in range(len(points)):
        rows = order[starts[m] : starts[m + 1]]
        if len(rows) < 2 and (fb == 0.0 or len(rows) == 0 or np.isnan(disparity[rows[0]])):
            continue  # a single view does not tell the depth
        at = points[m].copy()
        cost = _normal_equations(
            at, poses, rows, camera, xy, disparity, sigma, sigma_d, intrinsics, fb, huber, h, b
        )
        if not np.isfinite(cost):
            continue
        damping = 1e-3
        for _ in range(iterations):
            step = _solve_3(h, b, damping)
            trial = at + step
            h_old, b_old = h.copy(), b.copy()
            new_cost = _normal_equations(
                trial,
                poses,
                rows,
                camera,
                xy,
                disparity,
                sigma,
                sigma_d,
                intrinsics,
                fb,
                huber,
                h,
                b,
            )
            if new_cost < cost:
                at, cost = trial, new_cost
                damping *= 0.1
            else:
                h[:], b[:] = h_old, b_old
                damping *= 10.0
        result[m] = at
    return result


@numba.njit(cache=True, nogil=True)
def _normal_equations(  # type: ignore[no-untyped-def]
    p, poses, rows, camera, xy, disparity, sigma, sigma_d, intrinsics, fb, huber, h, b
):
    """Fill h and b, return the Huber cost; infinite if the point is behind a camera."""
    fx, fy, cx, cy = intrinsics
    h[:] = 0.0
    b[:] = 0.0
    cost = 0.0
    j = np.zeros((3, 3))
    e = np.zeros(3)
    for i in rows:
        t = poses[camera[i]]
        x = t[0, 0] * p[0] + t[0, 1] * p[1] + t[0, 2] * p[2] + t[0, 3]
        y = t[1, 0] * p[0] + t[1, 1] * p[1] + t[1, 2] * p[2] + t[1, 3]
        z = t[2, 0] * p[0] + t[2, 1] * p[1] + t[2, 2] * p[2] + t[2, 3]
        if z < 1e-9:
            return np.inf
        s = sigma[i]
        e[0] = (fx * x / z + cx - xy[i, 0]) / s
        e[1] = (fy * y / z + cy - xy[i, 1]) / s
        measured = fb > 0.0 and not np.isnan(disparity[i])
        e[2] = (fb / z - disparity[i]) / sigma_d if measured else 0.0
        for c in range(3):
            j[0, c] = fx * (t[0, c] - x / z * t[2, c]) / (z * s)
            j[1, c] = fy * (t[1, c] - y / z * t[2, c]) / (z * s)
            j[2, c] = -fb * t[2, c] / (z * z * sigma_d) if measured else 0.0
        r = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
        weight = 1.0 if r < huber else huber / r
        cost += 0.5 * r * r if r < huber else huber * (r - 0.5 * huber)
        for row in range(3):
            for c in range(3):
                b[c] -= weight * j[row, c] * e[row]
                for d in range(3):
                    h[c, d] += weight * j[row, c] * j[row, d]
    return cost


@numba.njit(cache=True, nogil=True)
def _solve_3(h, b, damping):  # type: ignore[no-untyped-def]
    """Step of (h + damping * diag h) x = b by Cramer's rule; zero where it is singular."""
    a00, a11, a22 = h[0, 0] * (1 + damping), h[1, 1] * (1 + damping), h[2, 2] * (1 + damping)
    a01, a02, a12 = h[0, 1], h[0, 2], h[1, 2]
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    x = np.zeros(3)
    if determinant <= 1e-30 or not np.isfinite(determinant):
        return x
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    x[0] = (c00 * b[0] + c01 * b[1] + c02 * b[2]) / determinant
    x[1] = (c01 * b[0] + c11 * b[1] + c12 * b[2]) / determinant
    x[2] = (c02 * b[0] + c12 * b[1] + c22 * b[2]) / determinant
    return x
