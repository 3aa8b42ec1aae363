"""How well a window's poses and points explain what was seen."""

from __future__ import annotations

import numpy as np

from vo.types import Floats, WindowProblem


def residuals(
    problem: WindowProblem, world_from_cam: Floats, points: Floats, sigma_disparity_px: float
) -> tuple[Floats, Floats]:
    """Residual lengths (N,) in standard deviations, and depths (N,), of all observations."""
    fx, fy, cx, cy = problem.intrinsics
    pose = world_from_cam[problem.keyframe]
    offset = points[problem.point] - pose[:, :3, 3]
    in_cam = np.einsum("nji,nj->ni", pose[:, :3, :3], offset)
    depth = in_cam[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        du = (fx * in_cam[:, 0] / depth + cx - problem.xy[:, 0]) / problem.sigma_px
        dv = (fy * in_cam[:, 1] / depth + cy - problem.xy[:, 1]) / problem.sigma_px
        dd = (fx * problem.baseline_m / depth - problem.disparity) / sigma_disparity_px
    square = du**2 + dv**2 + np.where(np.isnan(problem.disparity), 0.0, dd**2)
    return np.where(depth > 0, np.sqrt(square), np.inf), depth
