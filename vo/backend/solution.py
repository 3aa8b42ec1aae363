"""All that a window says: where its poses and points lie, and how well it knows that."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.backend.bundle import Bundle
from vo.backend.calibration_residual import CalibrationResidual, estimate_calibration_residual
from vo.backend.gauge import gauge_of
from vo.backend.information import pose_information
from vo.backend.linearisation import linearise
from vo.types import Bools, Floats, WindowProblem

if TYPE_CHECKING:  # the smoother's process does without the settings, see `vo.backend.process`
    from vo.config import SmoothingConfig


class WindowSolution(NamedTuple):
    """What became of a `WindowProblem`.

    Attributes:
        world_from_cam: (K, 4, 4) adjusted.
        held: (K,) poses that stayed where they were: the fixed ones, or else the first.
        information: (6 K, 6 K) on all poses, tangent (rx ry rz tx ty tz) in the camera's own
            frame; 0 for poses that it does not determine.
        points: (M, 3) adjusted.
        point_ok: (M,) False for points that were dropped as degenerate.
        left: what the window says that the calibration leaves; None if it does not, or was not
            asked.
        converged: False if nothing could be adjusted; all is then as it was given.
    """

    world_from_cam: Floats
    held: Bools
    information: Floats
    points: Floats
    point_ok: Bools
    left: CalibrationResidual | None
    converged: bool


def smooth(problem: WindowProblem, config: SmoothingConfig) -> WindowSolution:
    """Adjust a window in this process, and tell what it then says."""
    from vo.backend.bundle_adjustment import adjust_window  # GTSAM takes long to import

    adjusted = adjust_window(problem, config)
    if adjusted is None:
        return unsolved(problem)
    poses, points, ok = adjusted
    held, scaled, sigmas = gauge_of(problem)
    linear = linearise(problem, poses, points, ok, config)
    information = pose_information(linear, config.covariance_scale)
    if scaled is not None:
        rows = np.arange(6 * scaled, 6 * scaled + 6)
        information[rows, rows] += sigmas**-2.0
    left = None
    if problem.calibrates:
        only_first = np.arange(len(poses)) == 0
        bundle = Bundle(replace(problem, points=points, fixed=only_first), ok, config)
        left = estimate_calibration_residual(
            bundle.normal_equations(poses, calibrates=True), bundle.unknowns
        )
    return WindowSolution(poses, held, information, points, ok, left, True)


def unsolved(problem: WindowProblem) -> WindowSolution:
    """A window that is left as it was given, and says nothing."""
    poses, points = problem.world_from_cam, problem.points
    nothing = np.zeros((6 * len(poses), 6 * len(poses)))
    ok = np.ones(len(points), dtype=bool)
    return WindowSolution(poses, gauge_of(problem).held, nothing, points, ok, None, False)
