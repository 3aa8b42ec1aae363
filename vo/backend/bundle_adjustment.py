"""GTSAM adjusts the poses of a window of keyframes and the landmarks they see (bundle adjustment).

What has left the window is kept as fixed poses with their observations, so that neither scale nor
heading can wander at the window's edge (Mur-Artal 2015, sec. VI-D).

The observations make one factor on all poses that may move: the landmarks are eliminated before
GTSAM sees it, because six thousand factors and a thousand points, built and linearised one by one,
take GTSAM some ten times as long to the same optimum (docs/accuracy.md). Keys are the poses' rows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import gtsam
import numpy as np

from vo.backend.bundle import Bundle, NormalEquations
from vo.backend.gauge import Gauge, gauge_of
from vo.backend.residuals import residuals
from vo.types import Bools, Floats, WindowProblem

if TYPE_CHECKING:  # the smoother's process does without the settings, see `vo.backend.process`
    from vo.config import SmoothingConfig

_UNDETERMINED = 1e-13  # eigenvalue, against the greatest, below which a direction is left alone
# Pivot of the hessian's root, against the greatest, from which on every direction is determined.
_LEAST_PIVOT = 1e-5


class AdjustedWindow(NamedTuple):
    """Where the K poses and M points of a window come to lie.

    Attributes:
        world_from_cam: (K, 4, 4).
        points: (M, 3).
        point_ok: (M,) False for points that were seen once only, or end up behind a camera.
    """

    world_from_cam: Floats
    points: Floats
    point_ok: Bools


def adjust_window(problem: WindowProblem, config: SmoothingConfig) -> AdjustedWindow | None:
    """Adjust a window; None where no landmark holds its poses."""
    point_ok = _well_seen(problem)
    anchor = gauge_of(problem)
    if anchor.held.all() or not point_ok[problem.point].any():
        return None
    bundle = Bundle(replace(problem, fixed=anchor.held), point_ok, config)
    world_from_cam = _optimised(problem.world_from_cam, anchor, bundle, config)
    points = bundle.points_for(world_from_cam)
    if not (np.isfinite(world_from_cam).all() and np.isfinite(points[point_ok]).all()):
        return None
    _, depth = residuals(problem, world_from_cam, points, config.sigma_disparity_px)
    point_ok[problem.point[~(depth > 0)]] = False
    return AdjustedWindow(world_from_cam, points, point_ok)


def _optimised(
    world_from_cam: Floats, anchor: Gauge, bundle: Bundle, config: SmoothingConfig
) -> Floats:
    """Poses (K, 4, 4) at the least cost, found by Levenberg and Marquardt."""
    free = np.flatnonzero(~anchor.held).tolist()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in free:
        values.insert(k, gtsam.Pose3(world_from_cam[k]))
    graph.add(_bundle_factor(world_from_cam, free, bundle))
    if anchor.scaled is not None:
        start = gtsam.Pose3(world_from_cam[anchor.scaled])
        noise = gtsam.noiseModel.Diagonal.Sigmas(anchor.sigmas)
        graph.add(gtsam.PriorFactorPose3(anchor.scaled, start, noise))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.iterations)
    parameters.setRelativeErrorTol(config.relative_error_tolerance)
    parameters.setlambdaInitial(1e-4)
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return _poses(world_from_cam, free, result)


def _bundle_factor(world_from_cam: Floats, free: list[int], bundle: Bundle) -> gtsam.CustomFactor:
    """All observations as one factor on the free poses, whose error has the cost as its square."""
    rows = 6 * len(free) + 1

    def error(
        _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Floats] | None
    ) -> Floats:
        poses = _poses(world_from_cam, free, values)
        if jacobians is None:
            length = np.sqrt(2.0 * bundle.cost(poses))
            return np.append(np.zeros(rows - 1), length)
        root, whitened = _square_root(bundle.normal_equations(poses))
        for i in range(len(free)):
            jacobians[i] = np.vstack([root[:, 6 * i : 6 * i + 6], np.zeros((1, 6))])
        return whitened

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), free, error)


def _square_root(normal: NormalEquations) -> tuple[Floats, Floats]:
    """Jacobian J (6 F, 6 F) and errors e (6 F + 1,) of least squares with these normal equations.

    J^T J is the hessian of the poses, J^T e[:-1] their gradient; the last error, which no pose
    changes, makes half the sum of squares the cost. By eigenvalues where the hessian leaves a
    direction open, as mono's leaves the scale.
    """
    factor = _triangular(normal.hessian)
    if factor is not None:
        error = np.asarray(np.linalg.solve(factor, normal.gradient), dtype=np.float64)
        return factor.T, np.r_[error, _rest(normal, error)]
    values, vectors = np.linalg.eigh(normal.hessian)
    determined = values > _UNDETERMINED * values[-1]
    root = np.where(determined, np.sqrt(np.maximum(values, 0.0)), 0.0)
    with np.errstate(divide="ignore"):
        inverse_root = np.where(determined, 1.0 / root, 0.0)
    error = np.asarray(inverse_root * (vectors.T @ normal.gradient), dtype=np.float64)
    return root[:, None] * vectors.T, np.r_[error, _rest(normal, error)]


def _triangular(hessian: Floats) -> Floats | None:
    """The lower triangle L with L L^T = hessian; None if that hardly determines a direction."""
    try:
        factor = np.asarray(np.linalg.cholesky(hessian), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    pivots = np.diag(factor)
    return factor if pivots.min() > _LEAST_PIVOT * pivots.max() else None


def _rest(normal: NormalEquations, error: Floats) -> float:
    """What no pose changes of the error's length."""
    return float(np.sqrt(max(2.0 * normal.cost - float(error @ error), 0.0)))


def _poses(world_from_cam: Floats, free: list[int], values: gtsam.Values) -> Floats:
    poses: Floats = world_from_cam.copy()
    for k in free:
        poses[k] = values.atPose3(k).matrix()
    return poses


def _well_seen(problem: WindowProblem) -> Bools:
    """Points seen in two keyframes at least, in front of all of them."""
    _, depth = residuals(problem, problem.world_from_cam, problem.points, 1.0)
    seen = np.bincount(problem.point, minlength=len(problem.points))
    ok: Bools = (seen >= 2) & np.isfinite(problem.points).all(axis=1)
    ok[problem.point[~(depth > 0)]] = False
    return ok
