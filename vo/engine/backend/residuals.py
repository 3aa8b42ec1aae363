"""Residuals of a window's observations."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.projection import from_world, pixel
from vo.base.types import Floats
from vo.engine.backend.window_problem import WindowProblem


def residuals(
    problem: WindowProblem, world_from_cam: Floats, points: Floats
) -> tuple[Floats, Floats]:
    """Residual lengths (N,) in standard deviations, and depths (N,), of all observations.

    The residual of a point that is not in front of the camera is infinite.
    """
    residual, depth = _residuals(
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
    return residual, depth


@compiled
def _residuals(  # type: ignore[no-untyped-def]
    poses, points, keyframe, point, xy, disparity, sigma, sigma_d, intrinsics, fb
):
    """See `residuals`; poses are world_from_cam."""
    residual, depth = np.empty(len(xy)), np.empty(len(xy))
    for n in range(len(xy)):
        k, m = keyframe[n], point[n]
        x, y, z = from_world(poses[k], points[m, 0], points[m, 1], points[m, 2])
        depth[n], residual[n] = z, np.inf
        if z > 0.0:
            near = 1.0 / z
            u, v = pixel(intrinsics, x, y, near)
            eu, ev = (u - xy[n, 0]) / sigma[n], (v - xy[n, 1]) / sigma[n]
            ed = 0.0 if np.isnan(disparity[n]) else (fb * near - disparity[n]) / sigma_d
            residual[n] = np.sqrt(eu * eu + ev * ev + ed * ed)
    return residual, depth
