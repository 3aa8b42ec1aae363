"""All that a window says: where its poses and points lie, and how well it knows that."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.config import SmoothingConfig
from vo.smoothing.covariance import covariances
from vo.smoothing.disparity_offset import DisparityOffset, disparity_offset
from vo.smoothing.pose_system import pose_system
from vo.types import AdjustedWindow, Bools, Floats, WindowProblem


class WindowSolution(NamedTuple):
    """What became of a `WindowProblem`.

    Attributes:
        world_from_cam: (K, 4, 4) adjusted.
        covariance: (K, 6, 6) relative to the fixed poses, tangent (rx ry rz tx ty tz) in the
            camera's own frame; NaN where it could not be computed.
        points: (M, 3) adjusted.
        point_ok: (M,) False for points that were dropped as degenerate.
        offset: in stereo what the window says of a constant error of its disparities.
        converged: False if nothing could be adjusted; all is then as it was given.
    """

    world_from_cam: Floats
    covariance: Floats
    points: Floats
    point_ok: Bools
    offset: DisparityOffset | None
    converged: bool


def complete(
    problem: WindowProblem, adjusted: AdjustedWindow, config: SmoothingConfig
) -> WindowSolution:
    """Add covariances and disparity offset to an adjusted window."""
    poses, points, ok = adjusted.world_from_cam, adjusted.points, adjusted.point_ok
    if not adjusted.converged:
        unknown = np.full((len(poses), 6, 6), np.nan)
        return WindowSolution(poses, unknown, points, ok, None, False)
    system = pose_system(problem, poses, points, ok, config)
    covariance = covariances(problem, system)
    offset = disparity_offset(system) if problem.baseline_m > 0.0 else None
    return WindowSolution(poses, covariance, points, ok, offset, True)
