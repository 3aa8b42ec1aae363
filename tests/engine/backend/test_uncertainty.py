"""Covariances of windows against the scatter of many of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from windows import (
    SIGMA_DISPARITY_PX,
    SIGMA_PX,
    Window,
    blocks,
    covariance_given_held,
    drive,
)

from vo.base.config import SmoothingConfig
from vo.base.types import Floats
from vo.engine.backend.covariance import propagated
from vo.engine.backend.information import OF_PATCHES, ErrorModel, pose_information
from vo.engine.backend.linearisation import linearise
from vo.engine.backend.residuals import residuals
from vo.engine.backend.solution import WindowSolution, solve

KINDS = [pytest.param(False, 2, id="mono"), pytest.param(True, 1, id="stereo")]
CONFIG = SmoothingConfig(huber=100.0, iterations=20, relative_error_tolerance=1e-9)
INDEPENDENT = ErrorModel(white=1.0, creep=0.0, disparity=1.0, disparity_bias=0.0)
SMALLER = ErrorModel(*(0.6 * sigma for sigma in OF_PATCHES))
TRIALS = 40


def _disturbed(window: Window, model: ErrorModel, rng: np.random.Generator) -> Window:
    """The window with errors drawn from the model."""
    p = window.problem
    of_points = (len(p.world_from_cam), len(p.points), 2)
    crept = model.creep * np.cumsum(rng.standard_normal(of_points), axis=0)[p.keyframe, p.point]
    own = model.white * rng.standard_normal(p.xy.shape)
    bias = model.disparity_bias * rng.standard_normal(len(p.points))[p.point]
    depth = model.disparity * rng.standard_normal(len(p.disparity)) + bias
    xy, disparity = p.xy + SIGMA_PX * (crept + own), p.disparity + SIGMA_DISPARITY_PX * depth
    return replace(window, problem=replace(p, xy=xy, disparity=disparity))


def _covariance(window: Window, solution: WindowSolution, model: ErrorModel) -> Floats:
    path = solution.world_from_cam, solution.points
    at = residuals(window.problem, *path)
    linear = linearise(window.problem, *path, solution.point_ok, CONFIG, at)
    information = pose_information(linear, 1.0, model)
    return blocks(propagated(information, solution.held, np.zeros_like(information)))


def _mean_nees(window: Window, true: ErrorModel, told: ErrorModel) -> Floats:
    """(K,) normalised squared errors of the free poses, averaged over the trials."""
    rng = np.random.default_rng(0)
    nees = []
    for _ in range(TRIALS):
        trial = _disturbed(window, true, rng)
        solution = solve(trial.with_guess(size=0.02).problem, CONFIG)  # not at the truth
        pairs = zip(
            window.errors(solution.world_from_cam),
            _covariance(trial, solution, told),
            solution.held,
            strict=True,
        )
        nees.append([xi @ np.linalg.solve(c, xi) for xi, c, held in pairs if not held])
    return np.mean(nees, axis=0)


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_nees_of_every_pose_is_that_of_six_degrees_of_freedom(stereo: bool, fixed: int) -> None:
    mean = _mean_nees(drive(6, 100, stereo=stereo, fixed=fixed), INDEPENDENT, INDEPENDENT)
    # The 95 % interval of each of the poses together (Bonferroni). Where all landmarks err alike,
    # weights by their residuals cost up to a quarter of the variance.
    low, high = chi2.ppf([0.025 / len(mean), 1 - 0.025 / len(mean)], 6 * TRIALS) / TRIALS
    assert np.all((0.9 * low < mean) & (mean < 1.25 * high)), mean
    assert 4.8 < np.mean(mean) < 7.5


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_errors_that_last_are_told_too(stereo: bool, fixed: int) -> None:
    window = drive(6, 100, stereo=stereo, fixed=fixed)
    assert 4.5 < np.mean(_mean_nees(window, OF_PATCHES, OF_PATCHES)) < 9.0
    assert np.mean(_mean_nees(window, OF_PATCHES, SMALLER)) > 12.0  # the check can fail


@pytest.mark.parametrize(("stereo", "fixed"), KINDS)
def test_uncertainty_grows_away_from_the_fixed_poses(stereo: bool, fixed: int) -> None:
    window = drive(stereo=stereo, fixed=fixed).with_noise(seed=8)
    covariance = covariance_given_held(solve(window.problem, SmoothingConfig()))
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), atol=1e-12)
    np.testing.assert_array_equal(covariance[:fixed], 0.0)
    size = np.einsum("kii->k", covariance[:, 3:, 3:])
    assert size[-1] > 1.2 * size[fixed] > 0


def test_the_scale_is_a_factor_on_all_covariances() -> None:
    problem = drive(stereo=True, fixed=1).problem
    one, four = (
        covariance_given_held(solve(problem, SmoothingConfig(covariance_scale=scale)))
        for scale in (1.0, 4.0)
    )
    np.testing.assert_allclose(four, 4.0 * one, rtol=1e-6)


# Errors of the poses that are held


def _information(rng: np.random.Generator, poses: int) -> Floats:
    root = rng.standard_normal((6 * poses, 6 * poses + 4))
    return np.asarray(root @ root.T)


def test_information_on_fixed_poses_alone_is_not_needed_where_they_are_known() -> None:
    problem = drive(stereo=True, fixed=3).with_guess(size=0.02).problem
    every = solve(problem, CONFIG)
    needed = solve(replace(problem, is_fixed_known=True), CONFIG)
    fixed = np.repeat(problem.fixed, 6)
    alone = fixed[:, None] & fixed
    assert np.abs(every.information[alone]).max() > 0.0
    np.testing.assert_array_equal(needed.information, np.where(alone, 0.0, every.information))
    known = np.zeros_like(every.information)
    found = (propagated(each.information, each.held, known) for each in (every, needed))
    np.testing.assert_array_equal(*found)


def test_a_chain_of_windows_gives_the_covariance_of_one_large_one() -> None:
    """Each window sees what binds its newest pose to the two before it, and nothing else."""
    rng = np.random.default_rng(2)
    steps = [_information(rng, 3) for _ in range(4)]
    whole = np.zeros((36, 36))
    for k, step in enumerate(steps):
        whole[6 * k : 6 * k + 18, 6 * k : 6 * k + 18] += step
    # The information that binds a pose to all before it, the later ones eliminated.
    joint = np.zeros((36, 36))
    left = whole.copy()
    conditional = {}
    for k in range(5, 0, -1):
        a, b = slice(0, 6 * k), slice(6 * k, 6 * k + 6)
        conditional[k] = (left[b, a].copy(), left[b, b].copy())
        left = left[a, a] - left[a, b] @ np.linalg.solve(left[b, b], left[b, a])
    for k in range(1, 6):
        size = 6 * k + 6
        information = np.zeros((size, size))
        information[6 * k :, : 6 * k], information[6 * k :, 6 * k :] = conditional[k]
        known = np.full((size, size), np.nan)
        known[: 6 * k, : 6 * k] = joint[: 6 * k, : 6 * k]
        joint[:size, :size] = propagated(information, np.arange(k + 1) < k, known)
    np.testing.assert_allclose(joint[6:, 6:], np.linalg.inv(whole[6:, 6:]), rtol=1e-6, atol=1e-9)


def test_a_held_pose_of_unknown_covariance_is_found_again() -> None:
    information = _information(np.random.default_rng(3), 4)
    known = np.zeros((24, 24))
    known[6:12, 6:12] = np.nan
    held = np.array([True, True, False, False])
    found = propagated(information, held, known)
    expected = np.linalg.inv(information[6:, 6:])
    np.testing.assert_allclose(found[6:, 6:], expected, rtol=1e-6, atol=1e-12)


def test_without_a_known_pose_nothing_is_known() -> None:
    information = _information(np.random.default_rng(4), 3)
    found = propagated(information, np.array([True, False, False]), np.full((18, 18), np.nan))
    assert np.isnan(found).all()


def test_what_the_window_does_not_determine_stays_unknown() -> None:
    information = _information(np.random.default_rng(5), 3)
    information[12:], information[:, 12:] = 0.0, 0.0
    found = propagated(information, np.array([True, False, False]), np.zeros((18, 18)))
    assert np.isfinite(found[:12, :12]).all()
    assert np.isnan(found[12:, 12:]).all()
