"""GTSAM adjusts the poses of a window of keyframes and the landmarks they see (bundle adjustment).

What has left the window is kept as fixed poses with their observations, so that neither scale nor
heading can wander at the window's edge (Mur-Artal 2015, sec. VI-D).

Keys are numbers: poses from 0 on, after them the points.
"""

from __future__ import annotations

import logging

import gtsam
import numpy as np

from vo.config import SmoothingConfig
from vo.smoothing.anchors import anchors
from vo.smoothing.residuals import residuals
from vo.types import AdjustedWindow, Bools, Ints, WindowProblem

_log = logging.getLogger(__name__)

_ANCHOR_SIGMAS = np.full(6, 1e-6)
_ATTEMPTS = 3


def adjust_window(problem: WindowProblem, config: SmoothingConfig) -> AdjustedWindow:
    """Adjust a window.

    Landmarks that come out degenerate (behind a camera, without parallax) are dropped and the
    window is built again; if that does not help either, all is returned as it was given.
    """
    point_ok = _well_seen(problem)
    for _ in range(_ATTEMPTS):
        try:
            return _solve(problem, point_ok, config)
        except RuntimeError as error:
            # GTSAM reports an indeterminate system by an exception that names one variable.
            bad = _weak_points(problem, point_ok)
            first_line = str(error).strip().splitlines()[0] if str(error).strip() else "no message"
            _log.debug("window is degenerate (%s), dropping %d points", first_line, bad.sum())
            point_ok &= ~bad
    return AdjustedWindow(problem.world_from_cam, problem.points, point_ok, False)


def _solve(problem: WindowProblem, point_ok: Bools, config: SmoothingConfig) -> AdjustedWindow:
    used = np.flatnonzero(point_ok[problem.point])
    if len(used) == 0:
        raise RuntimeError("no point holds the poses")
    graph, values = _build(problem, point_ok, used, config)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.iterations)
    parameters.setRelativeErrorTol(config.relative_error_tolerance)
    parameters.setlambdaInitial(1e-4)
    parameters.setLinearSolverType("SEQUENTIAL_CHOLESKY")
    parameters.setOrdering(_points_first(problem, point_ok))
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    keyframes = len(problem.world_from_cam)
    world_from_cam = np.stack([result.atPose3(k).matrix() for k in range(keyframes)])
    points = problem.points.copy()
    points[point_ok] = gtsam.utilities.extractPoint3(result)  # in the order of their keys
    _, depth = residuals(problem, world_from_cam, points, config.sigma_disparity_px)
    if not np.isfinite(world_from_cam).all():
        raise RuntimeError("poses are not finite")
    behind = np.zeros(len(points), dtype=bool)
    behind[problem.point[depth <= 0]] = True
    return AdjustedWindow(world_from_cam, points, point_ok & ~behind, True)


def _build(
    problem: WindowProblem, point_ok: Bools, used: Ints, config: SmoothingConfig
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, start in enumerate(problem.world_from_cam):
        values.insert(k, gtsam.Pose3(start))
    first = len(problem.world_from_cam)
    # A name of its own spares looking through some thirty overloads of insert.
    for m in np.flatnonzero(point_ok).tolist():
        values.insertPoint3(first + m, problem.points[m])
    _anchor(graph, problem)
    noise = _NoiseModels(config)
    measured = ~np.isnan(problem.disparity[used])
    _add_stereo(graph, problem, used[measured], noise)
    _add_mono(graph, problem, used[~measured], noise)
    return graph, values


def _add_stereo(
    graph: gtsam.NonlinearFactorGraph, problem: WindowProblem, used: Ints, noise: _NoiseModels
) -> None:
    fx, fy, cx, cy = problem.intrinsics
    camera = gtsam.Cal3_S2Stereo(fx, fy, 0.0, cx, cy, max(problem.baseline_m, 1e-9))
    rows = zip(
        problem.keyframe[used].tolist(),
        (len(problem.world_from_cam) + problem.point[used]).tolist(),
        problem.xy[used, 0].tolist(),
        (problem.xy[used, 0] - problem.disparity[used]).tolist(),
        problem.xy[used, 1].tolist(),
        problem.sigma_px[used].tolist(),
        strict=True,
    )
    # There are thousands of observations, and each call into GTSAM costs a microsecond.
    factor, pixels = gtsam.GenericStereoFactor3D, gtsam.StereoPoint2
    model, add = noise.stereo, graph.add
    for pose, point, left, right, v, sigma in rows:
        add(factor(pixels(left, right, v), model(sigma), pose, point, camera, False, False))


def _add_mono(
    graph: gtsam.NonlinearFactorGraph, problem: WindowProblem, used: Ints, noise: _NoiseModels
) -> None:
    fx, fy, cx, cy = problem.intrinsics
    camera = gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)
    keyframe, sigma_px = problem.keyframe[used], problem.sigma_px[used]
    for k in np.unique(keyframe).tolist():
        for sigma in np.unique(sigma_px[keyframe == k]).tolist():
            rows = used[(keyframe == k) & (sigma_px == sigma)]
            points = (len(problem.world_from_cam) + problem.point[rows]).astype(np.float64)
            gtsam.utilities.insertProjectionFactors(
                graph, k, points, problem.xy[rows].T, noise.mono(sigma), camera
            )


def _anchor(graph: gtsam.NonlinearFactorGraph, problem: WindowProblem) -> None:
    held, scaled, sigmas = anchors(problem)
    hold = gtsam.noiseModel.Diagonal.Sigmas(_ANCHOR_SIGMAS)
    for k in np.flatnonzero(held).tolist():
        graph.add(gtsam.PriorFactorPose3(k, gtsam.Pose3(problem.world_from_cam[k]), hold))
    if scaled is not None:
        pose, noise = problem.world_from_cam[scaled], gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        graph.add(gtsam.PriorFactorPose3(scaled, gtsam.Pose3(pose), noise))


class _NoiseModels:
    """Robust noise models, one object for each standard deviation that occurs."""

    def __init__(self, config: SmoothingConfig) -> None:
        self._config = config
        self._mono: dict[float, gtsam.noiseModel.Robust] = {}
        self._stereo: dict[float, gtsam.noiseModel.Robust] = {}

    def mono(self, sigma: float) -> gtsam.noiseModel.Robust:
        if sigma not in self._mono:
            self._mono[sigma] = self._robust(gtsam.noiseModel.Isotropic.Sigma(2, sigma))
        return self._mono[sigma]

    def stereo(self, sigma: float) -> gtsam.noiseModel.Robust:
        """Of (u_left, u_right, v), where u_right is measured from u_left: they err together."""
        if sigma not in self._stereo:
            a, d = sigma**2, self._config.sigma_disparity_px**2
            covariance = np.array([[a, a, 0.0], [a, a + d, 0.0], [0.0, 0.0, a]])
            self._stereo[sigma] = self._robust(gtsam.noiseModel.Gaussian.Covariance(covariance))
        return self._stereo[sigma]

    def _robust(self, base: gtsam.noiseModel.Base) -> gtsam.noiseModel.Robust:
        kernel = gtsam.noiseModel.mEstimator.Huber.Create(self._config.huber)
        return gtsam.noiseModel.Robust.Create(kernel, base)


def _points_first(problem: WindowProblem, point_ok: Bools) -> gtsam.Ordering:
    """Eliminating every point before any pose is the Schur complement of bundle adjustment."""
    ordering = gtsam.Ordering()
    first = len(problem.world_from_cam)
    for key in [*(first + np.flatnonzero(point_ok)).tolist(), *range(first)]:
        ordering.push_back(key)
    return ordering


def _well_seen(problem: WindowProblem) -> Bools:
    """Points seen in two keyframes at least, in front of all of them."""
    _, depth = residuals(problem, problem.world_from_cam, problem.points, 1.0)
    seen = np.bincount(problem.point, minlength=len(problem.points))
    ok: Bools = (seen >= 2) & np.isfinite(problem.points).all(axis=1)
    ok[problem.point[~(depth > 0)]] = False
    return ok


def _weak_points(problem: WindowProblem, point_ok: Bools) -> Bools:
    """The points whose rays differ least: the most likely cause of an indeterminate system."""
    centres = problem.world_from_cam[problem.keyframe, :3, 3]
    rays = problem.points[problem.point] - centres
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    total = np.zeros_like(problem.points)
    np.add.at(total, problem.point, rays)
    seen = np.maximum(np.bincount(problem.point, minlength=len(problem.points)), 1)
    spread = 1.0 - np.linalg.norm(total, axis=1) / seen
    if not point_ok.any():
        return point_ok.copy()
    limit = np.quantile(spread[point_ok], 0.2)
    return np.asarray(point_ok & (spread <= limit))
