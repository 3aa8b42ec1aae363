"""The solution of a window: poses, points, their information, and the calibration residual."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.geometry.quantiles import median
from vo.base.records.calibration_errors import CalibrationResidual
from vo.base.types import Bools, Floats
from vo.engine.backend.bundle import Bundle
from vo.engine.backend.bundle_adjustment import AdjustedWindow, adjust_window
from vo.engine.backend.calibration_residual import estimate_calibration_residual
from vo.engine.backend.information import MIN_OBSERVATIONS, information_blocks, pose_information
from vo.engine.backend.linearisation import linearise
from vo.engine.backend.path_equations import Levels
from vo.engine.backend.residuals import Residuals, residuals
from vo.engine.backend.window_problem import Ties, WindowProblem, gauge_of

if TYPE_CHECKING:  # only rigs need it
    from vo.engine.backend.rig_extrinsics import ExtrinsicEvidence

# Residuals say how large the errors of this recording are (the variance of unit weight): rooms have
# a third of the variance of corridors. Median in standard deviations where the factor is 1, and the
# least factor on standard deviations.
_USUAL_RESIDUAL, _LEAST_NOISE = 0.2, 0.2
_LANDMARKS = 20_000  # whose observations are linearised at once


class WindowSolution(NamedTuple):
    """The solution of a `WindowProblem` of K poses and M points.

    Of a rig, `held` and `information` are those of the bodies.

    Attributes:
        held: (K,) poses that stayed where they were: the fixed ones, or else the first.
        information: (6 K, 6 K) on all poses, tangent (rx ry rz tx ty tz) in the camera's own
            frame; 0 for poses that it does not determine.
        point_ok: (M,) False for degenerate points.
        calibration_residual: None if it is not determined, or not estimated.
        converged: False if nothing could be optimised; all is then as in the problem.
        metre: of a rig, change of the length of a metre in the map, and the information on it.
        extrinsics: of a rig, None if they are not estimated.
    """

    world_from_cam: Floats
    held: Bools
    information: Floats
    points: Floats
    point_ok: Bools
    calibration_residual: CalibrationResidual | None
    converged: bool
    states: dict[int, Floats]
    metre: tuple[float, float] = (0.0, 0.0)
    extrinsics: ExtrinsicEvidence | None = None


def solve(problem: WindowProblem, config: SmoothingConfig) -> WindowSolution:
    """Optimise a window in this process."""
    if problem.ties is not None:
        return _solve_rig(problem, problem.ties, config)
    adjusted = adjust_window(problem, config)
    if adjusted is None:
        return unsolved(problem)
    return WindowSolution(
        adjusted.world_from_cam,
        adjusted.gauge.held,
        _information(problem, adjusted, config),
        adjusted.points,
        adjusted.point_ok,
        _calibration_residual(problem, adjusted, config),
        True,
        adjusted.states,
    )


def _solve_rig(problem: WindowProblem, ties: Ties, config: SmoothingConfig) -> WindowSolution:
    from vo.engine.backend.rig_adjustment import adjust_rig  # only rigs need it
    from vo.engine.backend.rig_extrinsics import extrinsic_evidence

    adjusted = adjust_rig(problem, ties, config)
    if adjusted is None:
        return unsolved(problem)
    poses, points, ok = adjusted.world_from_cam, adjusted.points, adjusted.point_ok
    by_views = information_by_images(problem, poses, points, ok, config)
    information, on_metre = adjusted.information(by_views)
    found = poses, adjusted.held, information, points, ok
    evidence = None if ties.cameras is None else extrinsic_evidence(problem, ties, adjusted, config)
    return WindowSolution(*found, None, True, {}, (adjusted.metre, on_metre), evidence)


def unsolved(problem: WindowProblem) -> WindowSolution:
    """A window left as it was, without information."""
    poses, points = problem.world_from_cam, problem.points
    nothing = np.zeros((6 * len(poses), 6 * len(poses)))
    ok = np.ones(len(points), dtype=bool)
    held = gauge_of(problem).held
    return WindowSolution(poses, held, nothing, points, ok, None, False, {})


def information_by_images(
    problem: WindowProblem,
    poses: Floats,
    points: Floats,
    ok: Bools,
    config: SmoothingConfig,
    at: Residuals | None = None,
    wanted: Bools | None = None,
) -> Floats:
    """(6 K, 6 K) of the observations on all poses, with the noise that their residuals show.

    `at`: the residuals there, if they are known; `wanted`: see `pose_information`.
    """
    at = at or residuals(problem, poses, points)
    linear = linearise(problem, poses, points, ok, config, at)
    return pose_information(linear, _scale(at, ok[problem.point], config), wanted=wanted)


def blocks_by_images(
    problem: WindowProblem,
    path: tuple[Floats, Floats],
    ok: Bools,
    config: SmoothingConfig,
    levels: Levels,
) -> Floats | None:
    """Blocks of the same in the order of levels; None where a pose has too few observations."""
    flat, seen = np.zeros(0), np.zeros(len(levels.order), np.int64)
    for first in range(0, len(ok), _LANDMARKS):  # Jacobians of all would need too much memory
        part = problem.point // _LANDMARKS == first // _LANDMARKS
        chosen = problem.select(np.flatnonzero(part))
        linear = linearise(chosen, *path, ok, config, residuals(chosen, *path))
        seen += linear.seen
        blocks = information_blocks(linear, levels.row[:-1], levels.place)
        flat = flat + blocks if len(flat) else blocks
    if seen.min() < MIN_OBSERVATIONS:
        return None
    return flat / _scale(residuals(problem, *path), ok[problem.point], config)


def _scale(at: Residuals, used: Bools, config: SmoothingConfig) -> float:
    """Of covariances, by the residuals that are used (N,)."""
    noise = max(median(at.length[used]) / _USUAL_RESIDUAL, _LEAST_NOISE)
    return config.covariance_scale * noise**2


def _information(
    problem: WindowProblem, adjusted: AdjustedWindow, config: SmoothingConfig
) -> Floats:
    poses, points, ok = adjusted.world_from_cam, adjusted.points, adjusted.point_ok
    wanted = ~problem.fixed if problem.is_fixed_known else None
    information = information_by_images(
        problem, poses, points, ok, config, adjusted.residuals, wanted
    )
    _, scaled, sigmas = adjusted.gauge
    if scaled is not None:
        rows = np.arange(6 * scaled, 6 * scaled + 6)
        information[rows, rows] += sigmas**-2.0
    if adjusted.information is not None:
        information += adjusted.information
    return information


def _calibration_residual(
    problem: WindowProblem, adjusted: AdjustedWindow, config: SmoothingConfig
) -> CalibrationResidual | None:
    if not problem.estimates_calibration:
        return None
    poses = adjusted.world_from_cam
    only_first = np.arange(len(poses)) == 0
    free = replace(problem, points=adjusted.points, fixed=only_first)
    bundle = Bundle(free, adjusted.point_ok, config)
    normal = bundle.normal_equations(poses, with_calibration=True)
    return estimate_calibration_residual(normal, bundle.calibration_size, bundle.check_size)
