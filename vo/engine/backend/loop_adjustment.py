"""Bundle adjustment of a path with loops: all observations, and measured motions between poses.

The points are eliminated as in windows (`bundle`). What is left are dense normal equations of the
poses, to which each loop adds its own, damped as by Levenberg and Marquardt. GTSAM would need the
square root of the dense hessian in each step, whose decomposition takes ten times as long where,
with one camera, the scale is hardly determined.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse, orthonormalised
from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.bundle import Bundle
from vo.engine.backend.residuals import residuals
from vo.engine.backend.solution import information_by_images
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.geometry import sim3

if TYPE_CHECKING:
    from vo.base.config import SmoothingConfig

_HUBER = 1.345  # standard deviations from which the error of a motion weighs less
_FIRST_DAMPING, _MAX_DAMPING = 1e-6, 1e3  # relative to the diagonal of the hessian
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
    """Optimise all poses but the first, and all points; None where nothing can be optimised.

    The fixed poses and further factors of the problem are ignored. Steps end at a relative decrease
    of the cost; the damping, which slows a drift of the scale, is less where that is.
    """
    count, usable = len(problem.world_from_cam), _usable(problem)
    if count < 2 or not usable.any():
        return None
    bundle = Bundle(replace(problem, fixed=np.arange(count) == 0), usable, config)
    edges = _Edges(motions)
    poses = problem.world_from_cam
    cost = bundle.cost(poses) + edges.cost(poses)
    damping = least = _FIRST_DAMPING * min(min_decrease / _MIN_DECREASE, 1.0)
    for _ in range(_MAX_STEPS):
        normal = bundle.normal_equations(poses)
        hessian, gradient = edges.added_to(normal.hessian, normal.gradient, poses)
        before = cost
        while damping <= _MAX_DAMPING:
            moved = _moved(poses, _step(hessian, gradient, damping))
            new = bundle.cost(moved) + edges.cost(moved)
            if new < cost:
                poses, cost, damping = moved, new, max(0.1 * damping, least)
                break
            damping *= 10.0
        if before - cost <= min_decrease * before:
            break
    points = bundle.points_for(poses)
    if not (np.isfinite(poses).all() and np.isfinite(points[usable]).all()):
        return None
    return AdjustedPath(poses, points)


def path_covariance(
    problem: WindowProblem, path: AdjustedPath, motions: Motions, config: SmoothingConfig
) -> Floats | None:
    """(K, 6, 6) of the poses relative to the first one; None where they are not determined."""
    poses, count = path.world_from_cam, len(path.world_from_cam) - 1
    usable = _usable(problem)
    information = information_by_images(problem, poses, path.points, usable, config)[6:, 6:]
    information /= _MORE_ALIKE
    information, _ = _Edges(motions).added_to(information, np.zeros(6 * count), poses)
    if problem.baseline_m == 0.0:
        by_scale = np.zeros((count, 6))
        first = poses[1:_OF_UNIT]
        by_scale[: len(first), 3:] = np.einsum(
            "kji,kj->ki", first[:, :3, :3], first[:, :3, 3] - poses[0, :3, 3]
        )
        by_scale /= max(float((by_scale**2).sum()), 1e-300) * _UNIT_SIGMA
        information += np.outer(by_scale, by_scale)
    try:
        np.linalg.cholesky(information)
    except np.linalg.LinAlgError:
        return None
    blocks = np.linalg.inv(information).reshape(count, 6, count, 6)
    own = blocks[np.arange(count), :, np.arange(count)]
    return np.concatenate([np.zeros((1, 6, 6)), 0.5 * (own + np.swapaxes(own, 1, 2))])


def calibration_step(problem: WindowProblem, config: SmoothingConfig) -> Floats:
    """Errors of the calibration that go with the path, estimated together with all poses.

    With one camera (1,) how much larger k1 is than that of the pixels; with two (2,) offset and
    curve of disparities, see `RectifiedRig.disparity_error`.
    """
    first = np.arange(len(problem.world_from_cam)) == 0
    bundle = Bundle(replace(problem, fixed=first), _usable(problem), config)
    normal = bundle.normal_equations(problem.world_from_cam, with_calibration=True)
    size = 6 * (len(first) - 1) + bundle.calibration_size
    hessian = normal.hessian[:size, :size]
    damped = hessian + 1e-9 * np.diag(np.diag(hessian))  # the scale of the path is free
    step = -np.linalg.solve(damped, normal.gradient[:size])
    return np.asarray(step[-bundle.calibration_size :])


def _usable(problem: WindowProblem) -> Bools:
    """(M,) points that two keyframes observe, none of them from behind."""
    _, depth = residuals(problem, problem.world_from_cam, problem.points)
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

    def added_to(self, hessian: Floats, gradient: Floats, poses: Floats) -> tuple[Floats, Floats]:
        """Normal equations with those of the motions; the first pose has no rows in them."""
        errors = self._errors(poses)
        weight = _HUBER / np.maximum(np.linalg.norm(errors, axis=1), _HUBER)
        earlier, later = self._motions.earlier, self._motions.later
        later_from_earlier = inverse(poses[later]) @ poses[earlier]
        by_later = self._whitening
        by_earlier = -self._whitening @ adjoint(later_from_earlier)
        hessian, gradient = hessian.copy(), gradient.copy()
        for n in range(len(earlier)):
            ends = ((int(earlier[n]), by_earlier[n]), (int(later[n]), by_later[n]))
            for row, by_row in ends:
                if row == 0:
                    continue
                at = slice(6 * row - 6, 6 * row)
                gradient[at] += weight[n] * by_row.T @ errors[n]
                for column, by_column in ends:
                    if column > 0:
                        there = slice(6 * column - 6, 6 * column)
                        hessian[at, there] += weight[n] * by_row.T @ by_column
        return hessian, gradient

    def _errors(self, poses: Floats) -> Floats:
        """(L, 6) whitened tangents from the measured to the present motions."""
        present = inverse(poses[self._motions.earlier]) @ poses[self._motions.later]
        error = sim3.local(self._back @ present)[:, :6]
        return np.asarray(np.einsum("nij,nj->ni", self._whitening, error))


def _step(hessian: Floats, gradient: Floats, damping: float) -> Floats:
    """(K - 1, 6) tangents of the poses after the first; 0 where they are not determined."""
    diagonal = np.diag(hessian)
    damped = hessian + np.diag(damping * np.maximum(diagonal, 1e-9 * diagonal.max()))
    try:
        return np.asarray(np.linalg.solve(damped, -gradient)).reshape(-1, 6)
    except np.linalg.LinAlgError:
        return np.zeros((len(gradient) // 6, 6))


def _moved(poses: Floats, step: Floats) -> Floats:
    tangent = np.zeros((len(step), 7))
    tangent[:, :6] = step
    result = poses.copy()
    for k, motion in enumerate(sim3.retract(tangent), start=1):
        result[k] = orthonormalised(poses[k] @ motion)
    return result
