"""Residuals of a window's observations."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.projection import from_world, pixel
from vo.base.geometry.quantiles import median
from vo.base.types import Floats
from vo.engine.backend.window_problem import WindowProblem

# In standard deviations: residual of good landmarks, and one above which others are counted as it.
_GOOD_RESIDUAL, _MAX_RESIDUAL = 0.2, 4.0


class Residuals(NamedTuple):
    """Residuals of N observations; infinite where the point is not in front of the camera.

    Attributes:
        length: (N,) standard deviations.
        of_pixels: (N,) the same without disparities.
        depth: (N,) of the point.
    """

    length: Floats
    of_pixels: Floats
    depth: Floats


def residuals(problem: WindowProblem, world_from_cam: Floats, points: Floats) -> Residuals:
    """Residuals of all observations."""
    found = _residuals(
        np.ascontiguousarray(world_from_cam),
        np.ascontiguousarray(points),
        problem.keyframe,
        problem.point,
        problem.xy,
        problem.disparity,
        problem.sigma_px,
        problem.sigma_disparity_px,
        problem.intrinsics,
        problem.intrinsics[0] * problem.baseline_m,
    )
    return Residuals(*found)


def with_measured_noise(problem: WindowProblem, start: Residuals | None = None) -> WindowProblem:
    """The problem with standard deviations by its residuals at the start, as far as these show it.

    A patch on the edge of an object, a reflection or a shadow errs in all its observations, by some
    tenths of a pixel to the same side, which no threshold on single observations finds: the pixels
    of a landmark weigh less by the mean square of their residuals, as with Student's t
    distribution. Disparities compare two images of one time, and err by the calibration rather than
    the landmark: all have one factor.

    `start`: its residuals, if they are known.
    """
    both, pixels, _ = start or residuals(problem, problem.world_from_cam, problem.points)
    squared = np.minimum(pixels, _MAX_RESIDUAL) ** 2
    count = np.maximum(np.bincount(problem.point, minlength=len(problem.points)), 1)
    mean = np.bincount(problem.point, squared, len(problem.points)) / count
    sigma_px = problem.sigma_px * np.sqrt(1.0 + mean / _GOOD_RESIDUAL**2)[problem.point]
    sigma_disparity_px = problem.sigma_disparity_px
    known = np.flatnonzero(np.isfinite(problem.disparity) & np.isfinite(pixels))
    if len(known):
        usual = median(both[known] ** 2 - pixels[known] ** 2)
        sigma_disparity_px *= float(np.sqrt(1.0 + max(usual, 0.0) / _GOOD_RESIDUAL**2))
    return replace(problem, sigma_px=sigma_px, sigma_disparity_px=sigma_disparity_px)


@compiled
def _residuals(  # type: ignore[no-untyped-def]
    poses, points, keyframe, point, xy, disparity, sigma, sigma_d, intrinsics, fb
):
    """See `residuals`; poses are world_from_cam."""
    residual, of_pixels, depth = np.empty(len(xy)), np.empty(len(xy)), np.empty(len(xy))
    for n in range(len(xy)):
        k, m = keyframe[n], point[n]
        x, y, z = from_world(poses[k], points[m, 0], points[m, 1], points[m, 2])
        depth[n], residual[n], of_pixels[n] = z, np.inf, np.inf
        if z > 0.0:
            near = 1.0 / z
            u, v = pixel(intrinsics, x, y, near)
            eu, ev = (u - xy[n, 0]) / sigma[n], (v - xy[n, 1]) / sigma[n]
            ed = 0.0 if np.isnan(disparity[n]) else (fb * near - disparity[n]) / sigma_d
            of_pixels[n] = np.sqrt(eu * eu + ev * ev)
            residual[n] = np.sqrt(eu * eu + ev * ev + ed * ed)
    return residual, of_pixels, depth
