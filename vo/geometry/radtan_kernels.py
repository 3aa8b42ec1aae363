"""Compiled loops of the `radtan` lens, which every frame of an unrectified camera goes through.

In numpy they took a quarter of the time of tracking such a camera.
"""

from __future__ import annotations

import numpy as np

from vo.compiling.function import compiled


@compiled(error_model="numpy")
def radial(k, r2):  # type: ignore[no-untyped-def]
    """The radial factors (N,) and their derivatives by r^2 (N,)."""
    factor, slope = np.empty(len(r2)), np.empty(len(r2))
    for n in range(len(r2)):
        factor[n], slope[n] = _radial(k, r2[n])
    return factor, slope


@compiled(error_model="numpy")
def distort(k, rays, reach):  # type: ignore[no-untyped-def]
    """Where the lens moves points (N, 2); NaN beyond its reach."""
    moved = np.empty_like(rays)
    for n in range(len(rays)):
        x, y = rays[n, 0], rays[n, 1]
        moved_x, moved_y, _, _, _ = _moved(k, x, y)
        inside = not np.hypot(x, y) > reach
        moved[n, 0], moved[n, 1] = (moved_x, moved_y) if inside else (np.nan, np.nan)
    return moved


@compiled(error_model="numpy")
def undistort(k, moved, reach, iterations, converged, accepted):  # type: ignore[no-untyped-def]
    """The inverse by Newton's method; NaN where it leaves more than `accepted`.

    All points take as many steps as the slowest of them. Those that go astray, as they do where
    the lens folds soon after, are tried again from where they would be by the radial part alone.
    """
    rays = np.empty_like(moved)
    for n in range(len(moved)):
        rays[n, 0], rays[n, 1] = _clipped(moved[n, 0], moved[n, 1], reach)
    _approach(k, moved, rays, reach, iterations, converged)
    for n in range(len(moved)):
        if not _left_over(k, moved[n], rays[n]) <= accepted:
            share = _radial_inverse(k, np.hypot(moved[n, 0], moved[n, 1]), reach)
            rays[n, 0], rays[n, 1] = share * moved[n, 0], share * moved[n, 1]
            _approach(k, moved[n : n + 1], rays[n : n + 1], reach, iterations, converged)
            if not _left_over(k, moved[n], rays[n]) <= accepted:
                rays[n, 0], rays[n, 1] = np.nan, np.nan
    return rays


@compiled(error_model="numpy")
def _approach(k, moved, rays, reach, iterations, converged):  # type: ignore[no-untyped-def]
    """Newton's steps for `rays` that the lens would move to `moved`."""
    is_settled = False
    for _ in range(iterations):
        if is_settled:
            break
        is_settled = True
        for n in range(len(moved)):
            x, y = rays[n, 0], rays[n, 1]
            found_x, found_y, xx, xy, yy = _moved(k, x, y)
            determinant = xx * yy - xy * xy
            if abs(determinant) < 1e-12:
                determinant = 1e-12
            left_x, left_y = moved[n, 0] - found_x, moved[n, 1] - found_y
            step_x = (yy * left_x - xy * left_y) / determinant
            step_y = (xx * left_y - xy * left_x) / determinant
            x, y = _clipped(x + step_x, y + step_y, reach)
            if abs(step_x) > converged * (1.0 + abs(x)) or abs(step_y) > converged * (1.0 + abs(y)):
                is_settled = False
            rays[n, 0], rays[n, 1] = x, y


@compiled(error_model="numpy")
def _left_over(k, moved, ray):  # type: ignore[no-untyped-def]
    found_x, found_y, _, _, _ = _moved(k, ray[0], ray[1])
    return max(abs(found_x - moved[0]), abs(found_y - moved[1]))


@compiled(error_model="numpy")
def _radial_inverse(k, moved, reach):  # type: ignore[no-untyped-def]
    """Share of a moved radius that the radius was, by bisection: up to `reach` it grows."""
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
    """A moved point and the derivative: xx, xy (= yx), yy."""
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
    above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    above_slope = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])
    below_slope = k[5] + r2 * (2.0 * k[6] + 3.0 * r2 * k[7])
    factor = above / below
    return factor, (above_slope - factor * below_slope) / below


@compiled(error_model="numpy")
def _clipped(x, y, reach):  # type: ignore[no-untyped-def]
    """A point pulled back to a radius, so that no step lands behind the fold."""
    share = reach / max(np.hypot(x, y), 1e-300)
    if share >= 1.0:
        share = 1.0
    return x * share, y * share
