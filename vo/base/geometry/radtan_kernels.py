"""Compiled `radtan` lens model, used for every frame of an unrectified camera.

    x' = x f + 2 p1 x y + p2 (r^2 + 2 x^2),    y' = y f + p1 (r^2 + 2 y^2) + 2 p2 x y,
    f = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6),

with r^2 = x^2 + y^2, and k the array k1, k2, p1, p2, k3, k4, k5, k6. In numpy these took a quarter
of the time of tracking such a camera. Points are rows of (N, 2).
"""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled


@compiled(error_model="numpy")
def radial(k, r2):  # type: ignore[no-untyped-def]
    """Radial factors f (N,) and their derivatives by r^2 (N,)."""
    factor, slope = np.empty(len(r2)), np.empty(len(r2))
    for n in range(len(r2)):
        factor[n], slope[n] = _radial(k, r2[n])
    return factor, slope


@compiled(error_model="numpy")
def distort(k, rays, reach):  # type: ignore[no-untyped-def]
    """Distorted points (N, 2) of points (N, 2); NaN beyond the radius `reach`."""
    moved = np.empty_like(rays)
    for n in range(len(rays)):
        x, y = rays[n, 0], rays[n, 1]
        moved_x, moved_y, _, _, _ = _moved(k, x, y)
        inside = _is_within(x, y, reach) or not np.hypot(x, y) > reach
        moved[n, 0], moved[n, 1] = (moved_x, moved_y) if inside else (np.nan, np.nan)
    return moved


@compiled(error_model="numpy")
def undistort(k, moved, reach, iterations, converged, accepted):  # type: ignore[no-untyped-def]
    """Inverse by Newton's method; NaN where the residual exceeds `accepted`.

    All points take as many steps as the slowest. Points that do not converge, as near the reach of
    the lens, are tried again from the inverse of the radial part alone.
    """
    rays = np.empty_like(moved)
    for n in range(len(moved)):
        rays[n, 0], rays[n, 1] = _clipped(moved[n, 0], moved[n, 1], reach)
    _approach(k, moved, rays, reach, iterations, converged)
    for n in range(len(moved)):
        if not _residual(k, moved[n], rays[n]) <= accepted:
            ratio = _radial_inverse(k, np.hypot(moved[n, 0], moved[n, 1]), reach)
            rays[n, 0], rays[n, 1] = ratio * moved[n, 0], ratio * moved[n, 1]
            _approach(k, moved[n : n + 1], rays[n : n + 1], reach, iterations, converged)
            if not _residual(k, moved[n], rays[n]) <= accepted:
                rays[n, 0], rays[n, 1] = np.nan, np.nan
    return rays


@compiled(error_model="numpy")
def _approach(k, moved, rays, reach, iterations, converged):  # type: ignore[no-untyped-def]
    """Newton's steps, in place, for `rays` whose distorted points are `moved`."""
    has_converged = False
    for _ in range(iterations):
        if has_converged:
            break
        has_converged = True
        for n in range(len(moved)):
            x, y = rays[n, 0], rays[n, 1]
            found_x, found_y, xx, xy, yy = _moved(k, x, y)
            determinant = xx * yy - xy * xy
            if abs(determinant) < 1e-12:
                determinant = 1e-12
            rest_x, rest_y = moved[n, 0] - found_x, moved[n, 1] - found_y
            step_x = (yy * rest_x - xy * rest_y) / determinant
            step_y = (xx * rest_y - xy * rest_x) / determinant
            x, y = _clipped(x + step_x, y + step_y, reach)
            if abs(step_x) > converged * (1.0 + abs(x)) or abs(step_y) > converged * (1.0 + abs(y)):
                has_converged = False
            rays[n, 0], rays[n, 1] = x, y


@compiled(error_model="numpy")
def _residual(k, moved, ray):  # type: ignore[no-untyped-def]
    """Maximum of the residuals in x and y."""
    found_x, found_y, _, _, _ = _moved(k, ray[0], ray[1])
    return max(abs(found_x - moved[0]), abs(found_y - moved[1]))


@compiled(error_model="numpy")
def _radial_inverse(k, moved, reach):  # type: ignore[no-untyped-def]
    """Ratio of a radius to its distorted radius `moved`, by bisection up to `reach`."""
    low, high = 0.0, min(reach, 1e6)
    for _ in range(60):
        middle = (low + high) / 2.0
        factor, _ = _radial(k, middle * middle)
        if middle * factor < moved:
            low = middle
        else:
            high = middle
    return low / max(moved, 1e-300)


@compiled(error_model="numpy")
def _moved(k, x, y):  # type: ignore[no-untyped-def]
    """Distorted point, and its derivatives dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
    p1, p2 = k[2], k[3]
    r2 = x * x + y * y
    factor, slope = _radial(k, r2)
    moved_x = x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    moved_y = y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    dxx = factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    dxy = 2.0 * (x * y * slope + p1 * x + p2 * y)
    dyy = factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return moved_x, moved_y, dxx, dxy, dyy


@compiled(error_model="numpy")
def _radial(k, r2):  # type: ignore[no-untyped-def]
    """Radial factor f and its derivative by r^2."""
    numerator = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    numerator_slope = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])
    denominator_slope = k[5] + r2 * (2.0 * k[6] + 3.0 * r2 * k[7])
    factor = numerator / denominator
    return factor, (numerator_slope - factor * denominator_slope) / denominator


@compiled(error_model="numpy")
def _clipped(x, y, reach):  # type: ignore[no-untyped-def]
    """Point moved to the radius `reach` if it is beyond, where the polynomial decreases."""
    if _is_within(x, y, reach):
        return x, y
    ratio = reach / max(np.hypot(x, y), 1e-300)
    if ratio >= 1.0:
        ratio = 1.0
    return x * ratio, y * ratio


@compiled(error_model="numpy")
def _is_within(x, y, reach):  # type: ignore[no-untyped-def]
    """Whether a point is within the radius `reach` for certain; `hypot` takes half of the time."""
    return x * x + y * y < 0.99 * reach * reach
