"""How well a window's poses and points explain what was seen."""

from __future__ import annotations

import numpy as np

from vo.backend.window_problem import WindowProblem
from vo.compiling.function import compiled
from vo.types import Floats


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
        np.array(problem.intrinsics),
        problem.intrinsics[0] * problem.baseline_m,
    )
    return residual, depth


@compiled
def _residuals(  # type: ignore[no-untyped-def]
    poses, points, keyframe, point, xy, disparity, sigma, sigma_d, intrinsics, fb
):
    residual, depth = np.empty(len(xy)), np.empty(len(xy))
    for n in range(len(xy)):
        k, m = keyframe[n], point[n]
        d0, d1, d2 = (
            points[m, 0] - poses[k, 0, 3],
            points[m, 1] - poses[k, 1, 3],
            points[m, 2] - poses[k, 2, 3],
        )
        x = poses[k, 0, 0] * d0 + poses[k, 1, 0] * d1 + poses[k, 2, 0] * d2
        y = poses[k, 0, 1] * d0 + poses[k, 1, 1] * d1 + poses[k, 2, 1] * d2
        z = poses[k, 0, 2] * d0 + poses[k, 1, 2] * d1 + poses[k, 2, 2] * d2
        depth[n], residual[n] = z, np.inf
        if z > 0.0:
            near = 1.0 / z
            u = (intrinsics[0] * x * near + intrinsics[2] - xy[n, 0]) / sigma[n]
            v = (intrinsics[1] * y * near + intrinsics[3] - xy[n, 1]) / sigma[n]
            d = 0.0 if np.isnan(disparity[n]) else (fb * near - disparity[n]) / sigma_d
            residual[n] = np.sqrt(u * u + v * v + d * d)
    return residual, depth
