"""Bundle adjustment of a window of keyframes.

Keyframes that have left the window stay as fixed poses with their observations, so that neither
scale nor heading can drift at the window's edge (Mur-Artal 2015, sec. VI-D).

Landmarks are eliminated, so that the free poses are the only variables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.geometry.transforms import inverse, se3_log, whole_transforms
from vo.base.types import Bools, Floats
from vo.engine.backend.bundle import Bundle
from vo.engine.backend.residuals import Residuals, residuals, with_measured_noise
from vo.engine.backend.window_problem import Gauge, WindowProblem, gauge_of
from vo.engine.geometry.levenberg_marquardt import Law, dense_steps, minimise
from vo.engine.geometry.so3 import exp_rows


class AdjustedWindow(NamedTuple):
    """Result for a window of K poses and M points.

    Attributes:
        gauge: with the poses that were held.
        point_ok: (M,) False for points with one observation, or behind a camera at the end.
        information: (6 K, 6 K) of the further factors on the poses, None without any.
        residuals: of the problem.
    """

    gauge: Gauge
    world_from_cam: Floats
    points: Floats
    point_ok: Bools
    states: dict[int, Floats]
    information: Floats | None
    residuals: Residuals


def adjust_window(problem: WindowProblem, config: SmoothingConfig) -> AdjustedWindow | None:
    """Optimise a window; None where no landmark constrains its poses."""
    start = residuals(problem, problem.world_from_cam, problem.points)
    point_ok = well_observed(problem, start.depth)
    gauge = gauge_of(problem)
    if gauge.held.all() or not point_ok[problem.point].any():
        return None
    weighted = replace(with_measured_noise(problem, start), fixed=gauge.held)
    bundle = Bundle(weighted, point_ok, config)
    states: dict[int, Floats] = {}
    information = None
    if problem.factors or config.solver == "gtsam":
        from vo.engine.backend.window_graph import WindowGraph  # importing GTSAM takes long

        graph = WindowGraph(problem, gauge, bundle)
        values = graph.optimise(config)
        world_from_cam, states = graph.poses(values), graph.states(values)
        information = graph.information(values)
    else:
        world_from_cam = _Window(problem, gauge, bundle).optimise(config)
    points = bundle.points_for(world_from_cam)
    if not (np.isfinite(world_from_cam).all() and np.isfinite(points[point_ok]).all()):
        return None
    remaining = residuals(problem, world_from_cam, points)
    point_ok[problem.point[~(remaining.depth > 0)]] = False
    return AdjustedWindow(gauge, world_from_cam, points, point_ok, states, information, remaining)


class _Window:
    """The free poses of a window as variables."""

    def __init__(self, problem: WindowProblem, gauge: Gauge, bundle: Bundle) -> None:
        self._start = problem.world_from_cam
        self._free = np.flatnonzero(~gauge.held)
        self._bundle = bundle
        self._scaled = gauge.scaled
        self._information = gauge.sigmas**-2.0

    def optimise(self, config: SmoothingConfig) -> Floats:
        """Minimise by Levenberg and Marquardt: (K, 4, 4) poses, the held ones unchanged."""
        return minimise(self, self._start, Law(config.iterations, config.relative_error_tolerance))

    def cost(self, state: Floats) -> float:
        """Half the squared errors."""
        off = self._off(state)
        return self._bundle.cost(state) + 0.5 * float(off @ (self._information * off))

    def steps(self, state: Floats) -> Callable[[float], Floats]:
        """By all damping alike."""
        hessian, gradient, _ = self._bundle.normal_equations(state)
        if self._scaled is not None:
            at = 6 * int(np.searchsorted(self._free, self._scaled)) + np.arange(6)
            hessian[at, at] += self._information
            gradient[at] += self._information * self._off(state)
        return dense_steps(hessian, gradient, np.ones(len(gradient)))

    def moved(self, state: Floats, step: Floats) -> Floats:
        """The poses after a step, of which rotation and translation are apart."""
        poses, tangent = state.copy(), step.reshape(-1, 6)
        by = np.concatenate([exp_rows(tangent[:, :3]), tangent[:, 3:, None]], axis=2)
        poses[self._free] = state[self._free] @ whole_transforms(by)
        return poses

    def _off(self, state: Floats) -> Floats:
        """(6,) what the pose with a prior is off its start."""
        if self._scaled is None:
            return np.zeros(6)
        return se3_log(inverse(self._start[self._scaled]) @ state[self._scaled])


def well_observed(problem: WindowProblem, depth: Floats) -> Bools:
    """(M,) points observed by at least two keyframes, in front of all of them at depths (N,)."""
    count = np.bincount(problem.point, minlength=len(problem.points))
    ok: Bools = (count >= 2) & np.isfinite(problem.points).all(axis=1)
    ok[problem.point[~(depth > 0)]] = False
    return ok
