"""Bundle adjustment of a path with loops: all observations, and measured motions between poses.

The points are eliminated as in windows (`bundle`). What is left are normal equations of the poses
(`path_equations`), to which each loop adds its own, damped as by Levenberg and Marquardt.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.geometry.transforms import adjoint, inverse, orthonormalised
from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.bundle import Bundle
from vo.engine.backend.path_equations import Levels, PathEquations, coupled_poses, levels_of
from vo.engine.backend.residuals import residuals
from vo.engine.backend.solution import blocks_by_images
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.geometry import sim3
from vo.engine.geometry.levenberg_marquardt import Law, minimise

_log = logging.getLogger(__name__)

_HUBER = 1.345  # standard deviations from which the error of a motion weighs less
_FIRST_DAMPING, _MAX_DAMPING = 1e-8, 1e3  # relative to the diagonal of the hessian
_MAX_STEPS = 30
_MIN_DECREASE = 1e-4  # of the cost, relative to it, below which steps end
# On variances: errors of long tracks have more in common (docs/experiments/covariances.md).
_MORE_ALIKE = 2.0
# With one camera the unit of length is that of so many first poses, to so much.
_OF_UNIT, _UNIT_SIGMA = 7, 1e-4


class Motions(NamedTuple):
    """Measured motions between rows of poses; rows belong together.

    Attributes:
        earlier_from_later: (L, 4, 4).
        covariance: (L, 6, 6) in the frame of the later pose, rotation before translation.
    """

    earlier: Ints
    later: Ints
    earlier_from_later: Floats
    covariance: Floats


MAX_WIDTH = 800  # poses of adjacent levels: steps of so many take 5 s and 0.6 GB
_NO_ROWS = np.empty(0, np.int64)
NO_MOTIONS = Motions(_NO_ROWS, _NO_ROWS, np.empty((0, 4, 4)), np.empty((0, 6, 6)))


class AdjustedPath(NamedTuple):
    """Result for K poses (K, 4, 4), the first one as it was, and M points (M, 3)."""

    world_from_cam: Floats
    points: Floats


def adjust_path(
    problem: WindowProblem,
    motions: Motions,
    config: SmoothingConfig,
    min_decrease: float = _MIN_DECREASE,
) -> AdjustedPath | None:
    """Optimise all poses but the first, and all points; None where they cannot be optimised.

    The fixed poses and further factors of the problem are ignored. Steps end at a relative decrease
    of the cost; the damping, which holds the drift of long paths, is less where that is.
    """
    usable = _usable(problem)
    if len(problem.world_from_cam) < 2 or not usable.any():
        return None
    problem, motions, levels = _ordered(problem, motions, usable)
    if levels.width > MAX_WIDTH:
        _log.warning("a path of which %d poses see the same is not adjusted", levels.width)
        return None
    path, damping = _Path(problem, usable, config, motions, levels), _FIRST_DAMPING
    damping *= min(min_decrease / _MIN_DECREASE, 1.0)
    law = Law(_MAX_STEPS, min_decrease, damping, damping, _MAX_DAMPING, _MAX_STEPS)
    poses = minimise(path, problem.world_from_cam, law)
    points = path.bundle.points_for(poses)
    if not (np.isfinite(poses).all() and np.isfinite(points[usable]).all()):
        return None
    return AdjustedPath(poses[levels.place], points)


def path_information(
    problem: WindowProblem, path: AdjustedPath, motions: Motions, config: SmoothingConfig
) -> PathEquations | None:
    """That of images and motions on all poses; None where they determine nothing."""
    usable = _usable(problem)
    _, motions, levels = _ordered(problem, motions, usable)
    poses, first = path.world_from_cam[levels.order], levels.place[:_OF_UNIT]
    flat = blocks_by_images(problem, path, usable, config, levels)
    if flat is None:
        return None
    equations = PathEquations(levels, flat / _MORE_ALIKE)
    _Edges(motions).add_to(equations, np.zeros(6 * len(poses)), poses)
    if problem.baseline_m == 0.0:
        by_scale = np.zeros((len(first), 6))
        by_scale[:, 3:] = np.einsum(
            "kji,kj->ki", poses[first, :3, :3], poses[first, :3, 3] - poses[0, :3, 3]
        )
        by_scale /= max(float((by_scale**2).sum()), 1e-300) * _UNIT_SIGMA
        for a, row in zip(first, by_scale, strict=True):
            for b, column in zip(first, by_scale, strict=True):
                if a <= b:
                    equations.add(a, b, np.outer(row, column))
    return equations


def path_covariance(information: PathEquations | None) -> Floats | None:
    """(K, 6, 6) of the poses relative to the first one; None where they are not determined."""
    try:
        return None if information is None else information.covariances()[information.levels.place]
    except np.linalg.LinAlgError:
        return None


def calibration_step(problem: WindowProblem, config: SmoothingConfig) -> Floats:
    """Errors of the calibration that go with the path, estimated together with all poses.

    With one camera (1,) how much larger k1 is than that of the pixels; with two (2,) offset and
    curve of disparities, see `RectifiedRig.disparity_error`.
    """
    usable = _usable(problem)
    problem, _, levels = _ordered(problem, NO_MOTIONS, usable)
    bundle = Bundle(problem, usable, config)
    equations, gradient = bundle.path_equations(
        problem.world_from_cam, levels, with_calibration=True
    )
    size = bundle.calibration_size
    coupling, own = (each[..., :size] for each in equations.shared())
    # The scale of the path is free.
    solved = equations.solve(np.column_stack([coupling, gradient[6:-6]]), 1e-9)
    left = np.column_stack([own[:size], gradient[-6:][:size]]) - coupling.T @ solved
    return np.asarray(-np.linalg.solve(left[:, :size], left[:, size]))


def levels_by(point_ok: Bools, point: Ints, keyframe: Ints, count: int, ends: Ints) -> Levels:
    """Levels of poses that landmarks couple, and motions between the rows in `ends` (L, 2)."""
    coupled = coupled_poses(point_ok, point, keyframe, count)
    coupled[:_OF_UNIT, :_OF_UNIT] = True
    coupled[ends[:, 0], ends[:, 1]] = coupled[ends[:, 1], ends[:, 0]] = True
    return levels_of(coupled)


def _ordered(
    problem: WindowProblem, motions: Motions, usable: Bools
) -> tuple[WindowProblem, Motions, Levels]:
    """The same with poses in the order of levels."""
    count = len(problem.world_from_cam)
    ends = np.column_stack([motions.earlier, motions.later])
    levels = levels_by(usable, problem.point, problem.keyframe, count, ends)
    place = levels.place
    problem = replace(
        problem,
        world_from_cam=problem.world_from_cam[levels.order],
        keyframe=place[problem.keyframe],
    )
    motions = motions._replace(earlier=place[motions.earlier], later=place[motions.later])
    return problem, motions, levels


def _usable(problem: WindowProblem) -> Bools:
    """(M,) points that two keyframes observe, none of them from behind."""
    depth = residuals(problem, problem.world_from_cam, problem.points).depth
    usable = np.bincount(problem.point, minlength=len(problem.points)) >= 2
    usable[problem.point[~(depth > 0)]] = False
    return usable


class _Edges:
    """Errors of the motions, whitened, with Huber's loss."""

    def __init__(self, motions: Motions) -> None:
        self._motions = motions
        self._back = inverse(motions.earlier_from_later)
        # With covariance = L L^T, errors e have the whitened ones L^-1 e.
        self._whitening = np.linalg.inv(np.linalg.cholesky(motions.covariance))

    def cost(self, poses: Floats) -> float:
        """Half the robust sum of squares for poses (K, 4, 4)."""
        size = np.linalg.norm(self._errors(poses), axis=1)
        return float(np.where(size < _HUBER, 0.5 * size**2, _HUBER * (size - 0.5 * _HUBER)).sum())

    def add_to(self, equations: PathEquations, gradient: Floats, poses: Floats) -> None:
        """Add the normal equations of the motions to those of the path, gradient (6 K,)."""
        errors = self._errors(poses)
        weight = _HUBER / np.maximum(np.linalg.norm(errors, axis=1), _HUBER)
        earlier, later = self._motions.earlier, self._motions.later
        later_from_earlier = inverse(poses[later]) @ poses[earlier]
        by_later = self._whitening
        by_earlier = -self._whitening @ adjoint(later_from_earlier)
        for n in range(len(earlier)):
            ends = ((int(earlier[n]), by_earlier[n]), (int(later[n]), by_later[n]))
            for row, by_row in ends:
                gradient[6 * row : 6 * row + 6] += weight[n] * by_row.T @ errors[n]
                for column, by_column in ends:
                    if row <= column:
                        equations.add(row, column, weight[n] * by_row.T @ by_column)

    def _errors(self, poses: Floats) -> Floats:
        """(L, 6) whitened tangents from the measured to the present motions."""
        present = inverse(poses[self._motions.earlier]) @ poses[self._motions.later]
        error = sim3.local(self._back @ present)[:, :6]
        return np.asarray(np.einsum("nij,nj->ni", self._whitening, error))


class _Path:
    """All poses but the first as variables."""

    def __init__(
        self,
        problem: WindowProblem,
        usable: Bools,
        config: SmoothingConfig,
        motions: Motions,
        levels: Levels,
    ) -> None:
        self.bundle, self._edges = Bundle(problem, usable, config), _Edges(motions)
        self._levels = levels

    def cost(self, state: Floats) -> float:
        """Half the robust sum of squares."""
        return self.bundle.cost(state) + self._edges.cost(state)

    def steps(self, state: Floats) -> Callable[[float], Floats]:
        """Damped by the diagonal of the hessian."""
        equations, gradient = self.bundle.path_equations(state, self._levels)
        self._edges.add_to(equations, gradient, state)
        return lambda damping: equations.solve(-gradient[6:, None], damping).reshape(-1, 6)

    def moved(self, state: Floats, step: Floats) -> Floats:
        """The poses after a step (K - 1, 6)."""
        result, tangent = state.copy(), np.zeros((len(step), 7))
        tangent[:, :6] = step
        for k, motion in enumerate(sim3.retract(tangent), start=1):
            result[k] = orthonormalised(state[k] @ motion)
        return result
