from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from windows import Window, covariance_given_held, drive, observed

from vo.base.config import SmoothingConfig
from vo.base.types import Floats, Ints
from vo.engine.backend.residuals import residuals
from vo.engine.backend.solution import WindowSolution, solve
from vo.engine.backend.window_problem import WindowProblem

CONFIG = SmoothingConfig()
PATIENT = SmoothingConfig(iterations=50, relative_error_tolerance=1e-12)

KINDS = [pytest.param(False, 2, id="mono"), pytest.param(True, 1, id="stereo")]


def _plus_points(
    window: Window, points: Floats, seen_by: list[Ints], xy: list[Floats]
) -> WindowProblem:
    """The problem with more points, and where the keyframes see them."""
    p = window.problem
    first = len(p.points)
    number = np.repeat(np.arange(first, first + len(points)), [len(s) for s in seen_by])
    count = len(number)
    return replace(
        p,
        points=np.vstack([p.points, points]),
        keyframe=np.concatenate([p.keyframe, *seen_by]),
        point=np.concatenate([p.point, number]),
        xy=np.vstack([p.xy, *xy]),
        disparity=np.concatenate([p.disparity, np.full(count, np.nan)]),
        sigma_px=np.concatenate([p.sigma_px, np.full(count, 0.5)]),
    )


def _residual(problem: WindowProblem, solution: WindowSolution) -> Floats:
    poses, points = solution.world_from_cam, solution.points
    return residuals(problem, poses, points)[0]


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_poses_and_points_return_to_the_truth_without_noise(stereo: bool, fixed: int) -> None:
    window = drive(stereo=stereo, fixed=fixed).with_guess()
    solution = solve(window.problem, PATIENT)
    assert solution.converged
    assert solution.point_ok.all()
    np.testing.assert_allclose(solution.world_from_cam, window.world_from_cam, atol=1e-6)
    np.testing.assert_allclose(solution.points, window.points, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(_residual(window.problem, solution), 0.0, atol=1e-3)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_errors_with_noise_are_small(stereo: bool, fixed: int) -> None:
    window = drive(stereo=stereo, fixed=fixed).with_noise(seed=1).with_guess()
    solution = solve(window.problem, CONFIG)
    errors = window.errors(solution.world_from_cam)
    assert solution.converged
    assert np.rad2deg(np.linalg.norm(errors[:, :3], axis=1)).max() < 0.1
    # Mono draws its scale from the 0.4 m between its fixed poses, 2.4 m before the last.
    assert np.linalg.norm(errors[:, 3:], axis=1).max() < (0.03 if stereo else 0.15)
    assert 0.5 < np.median(_residual(window.problem, solution)) < 2.5


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_gtsam_finds_the_same_poses(stereo: bool, fixed: int) -> None:
    problem = drive(stereo=stereo, fixed=fixed).with_noise(seed=1).with_guess().problem
    own = solve(problem, PATIENT)
    other = solve(problem, PATIENT.model_copy(update={"solver": "gtsam"}))
    np.testing.assert_allclose(other.world_from_cam, own.world_from_cam, atol=1e-5)
    np.testing.assert_allclose(other.points[own.point_ok], own.points[own.point_ok], atol=1e-3)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_fixed_poses_stay(stereo: bool, fixed: int) -> None:
    window = drive(stereo=stereo, fixed=3).with_noise(seed=2).with_guess()
    solution = solve(window.problem, CONFIG)
    held = window.world_from_cam[:3]
    np.testing.assert_allclose(solution.world_from_cam[:3], held, atol=1e-4)
    np.testing.assert_array_equal(solution.held, window.problem.fixed)


def test_stereo_without_fixed_poses_keeps_its_scale_and_its_first_pose() -> None:
    window = drive(stereo=True, fixed=0)
    guess = window.with_guess().problem.world_from_cam.copy()
    guess[0] = window.world_from_cam[0]
    problem = replace(window.problem, world_from_cam=guess)
    solution = solve(problem, PATIENT)
    np.testing.assert_allclose(solution.world_from_cam, window.world_from_cam, atol=1e-6)


def test_mono_without_fixed_poses_is_right_up_to_a_scale_near_the_guess() -> None:
    window = drive(stereo=False, fixed=0)
    solution = solve(window.problem, PATIENT)
    assert solution.converged
    np.testing.assert_allclose(solution.world_from_cam, window.world_from_cam, atol=1e-5)
    noisy = window.with_noise(seed=3)
    found = solve(noisy.problem, CONFIG).world_from_cam[:, :3, 3]
    scale = np.linalg.norm(found[-1]) / np.linalg.norm(window.world_from_cam[-1, :3, 3])
    assert scale == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(found / scale, window.world_from_cam[:, :3, 3], atol=0.05)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_outliers_hardly_move_the_poses(stereo: bool, fixed: int) -> None:
    window = drive(stereo=stereo, fixed=fixed).with_noise(seed=4)
    rng = np.random.default_rng(5)
    clean = window.errors(solve(window.problem, CONFIG).world_from_cam)
    xy = window.problem.xy.copy()
    wrong = rng.random(len(xy)) < 0.05
    xy[wrong] += rng.choice((-1, 1), (wrong.sum(), 2)) * rng.uniform(10, 40, (wrong.sum(), 2))
    problem = replace(window.problem, xy=xy)
    solution = solve(problem, CONFIG)
    residual = _residual(problem, solution)
    errors = window.errors(solution.world_from_cam)
    assert np.abs(errors - clean)[:, :3].max() < np.deg2rad(0.1)
    assert np.abs(errors - clean)[:, 3:].max() < 0.06
    assert np.median(residual[wrong]) > CONFIG.gate
    assert np.mean(residual[~wrong] > CONFIG.gate) < 0.05


# Degenerate landmarks


def _solved_beside(window: Window, problem: WindowProblem) -> Floats:
    """The solution's mask of good points; all else must be solved as if nothing was amiss."""
    solution = solve(problem, PATIENT)
    assert solution.converged
    good = len(window.points)
    np.testing.assert_allclose(solution.world_from_cam, window.world_from_cam, atol=1e-5)
    assert solution.point_ok[:good].mean() > 0.75
    kept = np.flatnonzero(solution.point_ok[:good])
    np.testing.assert_allclose(solution.points[kept], window.points[kept], rtol=1e-4, atol=1e-4)
    return solution.point_ok[good:]


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
@pytest.mark.parametrize(
    ("points", "seen"),
    [
        pytest.param([[0.5, 0.2, 0.3]], [[0, 4]], id="behind a camera"),
        pytest.param([[np.nan, 1.0, 5.0], [np.inf, 0.0, 9.0]], [[2, 3], [4, 5]], id="no number"),
        pytest.param([[0.5, 0.2, 9.0]], [[3]], id="seen once"),
    ],
)
def test_a_point_that_cannot_be_used_is_dropped(
    points: list[list[float]], seen: list[list[int]], stereo: bool, fixed: int
) -> None:
    window = drive(stereo=stereo, fixed=fixed)
    pixels = [np.full((len(each), 2), 100.0) for each in seen]
    by = [np.array(each) for each in seen]
    assert not _solved_beside(window, _plus_points(window, np.array(points), by, pixels)).any()


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
@pytest.mark.parametrize("distance", [1e5, 1e9, 1e14])
def test_points_without_parallax_do_no_harm(stereo: bool, fixed: int, distance: float) -> None:
    window = drive(stereo=stereo, fixed=fixed)
    directions = np.array([[0.1, 0.05, 1.0], [-0.2, 0.1, 1.0], [0.0, 0.0, 1.0]])
    seen, pixels = [], []
    for direction in directions:
        ray = direction @ window.world_from_cam[:5, :3, :3]
        pixels.append(ray[:, :2] / ray[:, 2:] * 500.0 + (320.0, 200.0))
        seen.append(np.arange(5))
    problem = _plus_points(window, distance * directions, seen, pixels)
    _solved_beside(window, problem)
    assert np.isfinite(covariance_given_held(solve(problem, PATIENT))).all()


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_points_that_only_one_place_saw_do_no_harm(stereo: bool, fixed: int) -> None:
    window = drive(stereo=stereo, fixed=fixed)
    poses = np.concatenate([window.world_from_cam, window.world_from_cam[-1:]])
    fixed_poses = np.append(window.problem.fixed, False)
    still = replace(window.problem, world_from_cam=poses, fixed=fixed_poses)
    last, count = len(poses) - 1, len(still.keyframe)
    again = np.flatnonzero(still.keyframe == last - 1)
    still = observed(still, np.append(np.arange(count), again))
    still.keyframe[count:] = last
    window = replace(window, problem=still, world_from_cam=poses)
    ray = np.array([0.1, -0.1, 1.0])
    point = poses[-1, :3, :3] @ (5.0 * ray) + poses[-1, :3, 3]
    pixels = np.tile(ray[:2] * 500.0 + (320.0, 200.0), (2, 1))
    problem = _plus_points(window, point[None], [np.array([last - 1, last])], [pixels])
    _solved_beside(window, problem)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_a_hopeless_window_comes_back_as_it_was_given(stereo: bool, fixed: int) -> None:
    problem = drive(stereo=stereo, fixed=fixed).with_guess().problem
    once = np.unique(problem.point, return_index=True)[1]
    hopeless = observed(problem, once)
    solution = solve(hopeless, CONFIG)
    assert not solution.converged
    np.testing.assert_array_equal(solution.world_from_cam, hopeless.world_from_cam)
    np.testing.assert_array_equal(solution.points, hopeless.points)
    assert np.isnan(covariance_given_held(solution)[problem.fixed.sum() :]).all()


def test_a_pose_that_sees_nothing_does_not_keep_the_others_from_being_solved() -> None:
    window = drive(stereo=True, fixed=1)
    p = window.with_guess().problem
    solution = solve(observed(p, np.flatnonzero(p.keyframe != 4)), PATIENT)
    others = np.arange(8) != 4
    assert solution.converged
    found = solution.world_from_cam[others]
    np.testing.assert_allclose(found, window.world_from_cam[others], atol=1e-5)
    assert np.isnan(covariance_given_held(solution)[4]).all()


def test_the_same_window_gives_the_same_bits_and_is_left_alone() -> None:
    problem = drive(stereo=True, fixed=1).with_noise(seed=6).with_guess().problem
    names = ("world_from_cam", "points", "xy")
    copies = [getattr(problem, name).copy() for name in names]
    first, again = solve(problem, CONFIG), solve(problem, CONFIG)
    np.testing.assert_array_equal(first.world_from_cam, again.world_from_cam)
    np.testing.assert_array_equal(first.points, again.points)
    for name, before in zip(names, copies, strict=True):
        np.testing.assert_array_equal(before, getattr(problem, name))


def test_a_window_is_forgotten_after_its_solution() -> None:
    problem = drive(stereo=True, fixed=1).with_guess().problem
    solve(problem, CONFIG)
    forgotten = weakref.ref(problem)
    del problem
    gc.collect()
    assert forgotten() is None
