"""Adjusts the poses of a window of keyframes and the landmarks they see (bundle adjustment).

What has left the window is kept as fixed poses with their observations, so that neither scale nor
heading can wander at the window's edge (Mur-Artal 2015, sec. VI-D).
"""

from __future__ import annotations

import logging

import gtsam
import numpy as np

from vo.config import SmoothingConfig
from vo.types import Bools, Floats, Ints, WindowProblem, WindowSolution

_log = logging.getLogger(__name__)

_ANCHOR_SIGMAS = np.full(6, 1e-6)
_ATTEMPTS = 3
# Standard deviation of a loosely held point, in units of its distance; GTSAM takes a point that
# is known a few thousand times worse in depth than across for singular.
_LOOSE = 1.0


def smooth(problem: WindowProblem, config: SmoothingConfig) -> WindowSolution:
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
    return _unchanged(problem, point_ok)


def _solve(problem: WindowProblem, point_ok: Bools, config: SmoothingConfig) -> WindowSolution:
    used = np.flatnonzero(point_ok[problem.point])
    if len(used) == 0:
        raise RuntimeError("no point holds the poses")
    graph, values = _build(problem, point_ok, used, config)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.iterations)
    parameters.setRelativeErrorTol(config.relative_error_tolerance)
    parameters.setlambdaInitial(1e-4)
    parameters.setLinearSolverType("SEQUENTIAL_CHOLESKY")
    parameters.setOrdering(_points_first(graph, problem, point_ok))
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    keyframes = len(problem.world_from_cam)
    world_from_cam = np.stack([result.atPose3(_pose(k)).matrix() for k in range(keyframes)])
    points = problem.points.copy()
    for m in np.flatnonzero(point_ok).tolist():
        points[m] = result.atPoint3(_point(m))
    residual, depth = residuals(problem, world_from_cam, points, config.sigma_disparity_px)
    if not np.isfinite(world_from_cam).all():
        raise RuntimeError("poses are not finite")
    behind = np.zeros(len(points), dtype=bool)
    behind[problem.point[depth <= 0]] = True
    covariance = _covariances(graph, result, problem, np.flatnonzero(point_ok))
    return WindowSolution(world_from_cam, covariance, points, point_ok & ~behind, residual, True)


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


def _build(
    problem: WindowProblem, point_ok: Bools, used: Ints, config: SmoothingConfig
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, start in enumerate(problem.world_from_cam):
        values.insert(_pose(k), gtsam.Pose3(start))
    for m in np.flatnonzero(point_ok).tolist():
        values.insert(_point(m), problem.points[m])
    _anchor(graph, problem)
    noise = _NoiseModels(config)
    fx, fy, cx, cy = problem.intrinsics
    mono = gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)
    stereo = gtsam.Cal3_S2Stereo(fx, fy, 0.0, cx, cy, max(problem.baseline_m, 1e-9))
    # Keys made once: there are thousands of observations, and each call into GTSAM costs.
    pose_keys = [_pose(k) for k in range(len(problem.world_from_cam))]
    point_keys = [_point(m) for m in range(len(problem.points))]
    rows = zip(
        [pose_keys[k] for k in problem.keyframe[used].tolist()],
        [point_keys[m] for m in problem.point[used].tolist()],
        problem.xy[used],
        problem.xy[used].tolist(),
        problem.disparity[used].tolist(),
        problem.sigma_px[used].tolist(),
        strict=True,
    )
    mono_factor, stereo_factor = gtsam.GenericProjectionFactorCal3_S2, gtsam.GenericStereoFactor3D
    for pose, point, xy, (u, v), d, sigma in rows:
        if d == d:  # not NaN
            measured = gtsam.StereoPoint2(u, u - d, v)
            model = noise.stereo(sigma)
            graph.add(stereo_factor(measured, model, pose, point, stereo, False, False))
        else:
            graph.add(mono_factor(xy, noise.mono(sigma), pose, point, mono, False, False))
    return graph, values


def _anchor(graph: gtsam.NonlinearFactorGraph, problem: WindowProblem) -> None:
    """Hold the fixed poses; a window without any is held by its first pose, and mono's scale."""
    hold = gtsam.noiseModel.Diagonal.Sigmas(_ANCHOR_SIGMAS)
    fixed = np.flatnonzero(problem.fixed)
    for k in fixed.tolist() if len(fixed) else [0]:
        graph.add(gtsam.PriorFactorPose3(_pose(k), gtsam.Pose3(problem.world_from_cam[k]), hold))
    if len(fixed) < 2 and problem.baseline_m == 0.0 and len(problem.world_from_cam) > 1:
        anchor = int(fixed[0]) if len(fixed) else 0
        others = problem.world_from_cam[:, :3, 3] - problem.world_from_cam[anchor, :3, 3]
        farthest = int(np.argmax(np.linalg.norm(others, axis=1)))
        if farthest == anchor:
            return
        length = float(np.linalg.norm(others[farthest]))
        sigmas = np.r_[np.full(3, 1.0), np.full(3, 0.02 * length)]
        scale = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        pose = gtsam.Pose3(problem.world_from_cam[farthest])
        graph.add(gtsam.PriorFactorPose3(_pose(farthest), pose, scale))


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


def _points_first(
    graph: gtsam.NonlinearFactorGraph, problem: WindowProblem, point_ok: Bools
) -> gtsam.Ordering:
    """Eliminating every point before any pose is the Schur complement of bundle adjustment."""
    ordering = gtsam.Ordering()
    for m in np.flatnonzero(point_ok).tolist():
        ordering.push_back(_point(m))
    for k in range(len(problem.world_from_cam)):
        ordering.push_back(_pose(k))
    return ordering


def _covariances(
    graph: gtsam.NonlinearFactorGraph, result: gtsam.Values, problem: WindowProblem, points: Ints
) -> Floats:
    """(K, 6, 6) of the free poses, 0 of the fixed ones, NaN of poses that nothing holds."""
    keyframes = len(problem.world_from_cam)
    covariance = np.full((keyframes, 6, 6), np.nan)
    covariance[problem.fixed] = 0.0
    marginals: gtsam.Marginals | None
    try:
        marginals = gtsam.Marginals(graph, result)
    except (RuntimeError, IndexError) as error:
        # A point without parallax makes the whole system singular. Held very loosely, it tells
        # the poses nothing about its depth, as it should be.
        _log.debug("covariance with all points held loosely: %s", error)
        marginals = _loosely_held(graph, result, points)
    if marginals is None:
        return covariance
    for k in np.flatnonzero(~problem.fixed).tolist():
        try:
            covariance[k] = marginals.marginalCovariance(_pose(k))
        except (RuntimeError, IndexError) as error:  # the latter for a pose that sees nothing
            _log.debug("no covariance of keyframe %d in the window: %s", k, error)
    return covariance


def _loosely_held(
    graph: gtsam.NonlinearFactorGraph, result: gtsam.Values, points: Ints
) -> gtsam.Marginals | None:
    held = gtsam.NonlinearFactorGraph(graph)
    centre = result.atPose3(_pose(0)).translation()
    for m in points.tolist():
        at = result.atPoint3(_point(m))
        distance = max(float(np.linalg.norm(at - centre)), 1e-3)
        loose = gtsam.noiseModel.Isotropic.Sigma(3, _LOOSE * distance)
        held.add(gtsam.PriorFactorPoint3(_point(m), at, loose))
    try:
        return gtsam.Marginals(held, result)
    except (RuntimeError, IndexError) as error:
        _log.debug("no covariance: %s", error)
        return None


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


def _unchanged(problem: WindowProblem, point_ok: Bools) -> WindowSolution:
    covariance = np.full((len(problem.world_from_cam), 6, 6), np.nan)
    residual, _ = residuals(problem, problem.world_from_cam, problem.points, 1.0)
    return WindowSolution(
        problem.world_from_cam, covariance, problem.points, point_ok, residual, False
    )


def _pose(k: int) -> int:
    return int(gtsam.symbol("x", int(k)))


def _point(m: int) -> int:
    return int(gtsam.symbol("l", int(m)))
