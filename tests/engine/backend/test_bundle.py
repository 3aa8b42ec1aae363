"""The window's one factor against GTSAM's own, one for each observation."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from windows import Window, drive

from vo.base.config import SmoothingConfig
from vo.base.geometry.transforms import se3_exp
from vo.base.types import Floats
from vo.engine.backend.bundle import Bundle
from vo.engine.backend.bundle_adjustment import adjust_window
from vo.engine.backend.residuals import with_measured_noise
from vo.engine.backend.window_problem import WindowProblem

PATIENT = SmoothingConfig(huber=1.0, iterations=100, relative_error_tolerance=1e-12)
KINDS = [pytest.param(False, 2, id="mono"), pytest.param(True, 1, id="stereo")]


def _noisy(stereo: bool, fixed: int) -> Window:
    """With noise, and one observation in twenty that is wrong."""
    window = drive(stereo=stereo, fixed=fixed).with_noise(seed=3).with_guess()
    xy = window.problem.xy.copy()
    xy[::20] += np.random.default_rng(4).uniform(-15, 15, xy[::20].shape)
    return replace(window, problem=replace(window.problem, xy=xy))


def _by_gtsam_alone(problem: WindowProblem, config: SmoothingConfig) -> tuple[Floats, float]:
    """Best poses (K, 4, 4) of a graph with one factor for each observation, and their cost."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses, first = problem.world_from_cam, len(problem.world_from_cam)
    for k, pose in enumerate(poses):
        values.insert(k, gtsam.Pose3(pose))
        if problem.fixed[k]:
            graph.add(gtsam.NonlinearEqualityPose3(k, gtsam.Pose3(pose)))
    for m, point in enumerate(problem.points):
        values.insert(first + m, point)
    fx, fy, cx, cy = problem.intrinsics
    mono = gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)
    stereo = gtsam.Cal3_S2Stereo(fx, fy, 0.0, cx, cy, max(problem.baseline_m, 1e-9))
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(config.huber)
    for k, m, xy, disparity, sigma in zip(
        problem.keyframe.tolist(),
        (first + problem.point).tolist(),
        problem.xy,
        problem.disparity,
        problem.sigma_px,
        strict=True,
    ):
        if problem.baseline_m > 0.0:
            # u_right is measured from u_left: they err together.
            a, d = sigma**2, problem.sigma_disparity_px**2
            covariance = np.array([[a, a, 0.0], [a, a + d, 0.0], [0.0, 0.0, a]])
            noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
            robust = gtsam.noiseModel.Robust.Create(kernel, noise)
            pixels = gtsam.StereoPoint2(xy[0], xy[0] - disparity, xy[1])
            graph.add(gtsam.GenericStereoFactor3D(pixels, robust, k, m, stereo))
        else:
            noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
            robust = gtsam.noiseModel.Robust.Create(kernel, noise)
            graph.add(gtsam.GenericProjectionFactorCal3_S2(xy, robust, k, m, mono))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(100)
    parameters.setRelativeErrorTol(1e-12)
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return np.stack([result.atPose3(k).matrix() for k in range(first)]), graph.error(result)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_the_optimum_is_that_of_gtsam_with_a_factor_for_each_observation(
    stereo: bool, fixed: int
) -> None:
    problem = _noisy(stereo, fixed).problem
    found = adjust_window(problem, PATIENT)
    assert found is not None and found.point_ok.all()
    weighted = with_measured_noise(problem)
    poses, cost = _by_gtsam_alone(weighted, PATIENT)
    assert np.linalg.norm(poses[-1] - problem.world_from_cam[-1]) > 0.01  # there was a way to go
    np.testing.assert_allclose(found.world_from_cam, poses, atol=1e-4)
    bundle = Bundle(weighted, found.point_ok, PATIENT)
    assert bundle.cost(found.world_from_cam) == pytest.approx(cost, rel=1e-4)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_the_gradient_is_that_of_the_cost(stereo: bool, fixed: int) -> None:
    problem = _noisy(stereo, fixed).problem
    bundle = Bundle(problem, np.ones(len(problem.points), dtype=bool), PATIENT)
    gradient = bundle.normal_equations(problem.world_from_cam).gradient
    free = np.flatnonzero(~problem.fixed)
    assert len(gradient) == 6 * len(free)
    step = 1e-6
    for row in (0, 2, 4, 6 * len(free) - 1):
        costs = []
        for sign in (1.0, -1.0):
            poses, xi = problem.world_from_cam.copy(), np.zeros(6)
            xi[row % 6] = sign * step
            poses[free[row // 6]] = poses[free[row // 6]] @ se3_exp(xi)
            costs.append(bundle.cost(poses))
        slope = (costs[0] - costs[1]) / (2 * step)
        assert gradient[row] == pytest.approx(slope, rel=1e-3, abs=1e-2)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_what_the_calibration_leaves_is_a_row_at_the_end(stereo: bool, fixed: int) -> None:
    # Without noise: what depends on it is left out of the derivative on purpose.
    problem = drive(stereo=stereo, fixed=fixed).problem
    fx, fy, cx, cy = problem.intrinsics
    ok = np.ones(len(problem.points), dtype=bool)

    def changed(amount: float) -> Bundle:
        if stereo:
            return Bundle(replace(problem, disparity=problem.disparity - amount), ok, PATIENT)
        rays = (problem.xy - (cx, cy)) / (fx, fy)
        bent = rays * (1.0 - amount * np.sum(rays**2, axis=1, keepdims=True))
        return Bundle(replace(problem, xy=bent * (fx, fy) + (cx, cy)), ok, PATIENT)

    poses = problem.world_from_cam
    alone, whole = (
        changed(0.01).normal_equations(poses, with_calibration=c) for c in (False, True)
    )
    size = len(alone.gradient)
    assert len(whole.gradient) == size + (3 if stereo else 2)
    np.testing.assert_allclose(whole.hessian[:size, :size], alone.hessian, rtol=1e-12)
    np.testing.assert_array_equal(whole.hessian, whole.hessian.T)
    step = 1e-4
    slope = (changed(0.01 + step).cost(poses) - changed(0.01 - step).cost(poses)) / (2 * step)
    assert whole.gradient[size] == pytest.approx(slope, rel=0.03)


def test_the_hessian_is_symmetric_and_tells_which_poses_see_nothing() -> None:
    problem = drive(stereo=True, fixed=1).with_noise(seed=5).problem
    blind = len(problem.world_from_cam) - 1
    kept = problem.keyframe != blind
    problem = replace(
        problem,
        keyframe=problem.keyframe[kept],
        point=problem.point[kept],
        xy=problem.xy[kept],
        disparity=problem.disparity[kept],
        sigma_px=problem.sigma_px[kept],
    )
    bundle = Bundle(problem, np.ones(len(problem.points), dtype=bool), PATIENT)
    hessian = bundle.normal_equations(problem.world_from_cam).hessian
    np.testing.assert_array_equal(hessian, hessian.T)
    np.testing.assert_array_equal(hessian[-6:], 0.0)
    assert np.linalg.eigvalsh(hessian[:-6, :-6]).min() > 0.0


def test_the_order_of_observations_does_not_matter() -> None:
    problem = _noisy(True, 1).problem
    order = np.random.default_rng(1).permutation(len(problem.point))
    shuffled = replace(
        problem,
        keyframe=problem.keyframe[order],
        point=problem.point[order],
        xy=problem.xy[order],
        disparity=problem.disparity[order],
        sigma_px=problem.sigma_px[order],
    )
    usable = np.ones(len(problem.points), bool)
    of_order, of_shuffled = (
        Bundle(each, usable, PATIENT).normal_equations(problem.world_from_cam)
        for each in (problem, shuffled)
    )
    np.testing.assert_allclose(of_shuffled.hessian, of_order.hessian, rtol=1e-9, atol=1e-3)
    np.testing.assert_allclose(of_shuffled.gradient, of_order.gradient, rtol=1e-9, atol=1e-6)
