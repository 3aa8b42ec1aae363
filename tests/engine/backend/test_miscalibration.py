from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from windows import Window, drive

from vo.base.config import SmoothingConfig
from vo.engine.backend.solution import solve

CONFIG = SmoothingConfig()


def _shifted(offset_px: float, seed: int, noise: float = 0.2) -> Window:
    window = drive(10, 400, stereo=True, fixed=1, step_m=0.6)
    rng = np.random.default_rng(seed)
    p = window.problem
    problem = replace(
        p,
        xy=p.xy + noise * rng.standard_normal(p.xy.shape),
        disparity=p.disparity + offset_px + noise * rng.standard_normal(len(p.disparity)),
    )
    return replace(window, problem=problem)


class Found(NamedTuple):
    """The first of what a window tells of, in stereo the offset."""

    value: float
    sigma: float


def _estimate(window: Window, which: int = 0) -> Found:
    found = solve(window.problem, CONFIG).calibration_residual
    assert found is not None
    covariance = np.linalg.inv(found.information)
    return Found(float(found.value[which]), float(np.sqrt(covariance[which, which])))


@pytest.mark.parametrize("offset_px", [-1.0, -0.3, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_an_offset_is_found_to_a_twentieth_of_a_pixel(offset_px: float, seed: int) -> None:
    found = _estimate(_shifted(offset_px, seed))
    # It is one linear step: of large offsets a little is left for the next window.
    assert found.value == pytest.approx(offset_px, abs=max(0.05, 0.12 * abs(offset_px)))
    assert 0.0 < found.sigma < 0.1


@pytest.mark.parametrize("offset_px", [-1.0, 1.0, -2.5])
def test_what_is_left_of_large_offsets_is_found_in_the_next_step(offset_px: float) -> None:
    window, found = _shifted(offset_px, 0), 0.0
    for _ in range(2):
        step = _estimate(window).value
        found += step
        left = window.problem.disparity - step
        window = replace(window, problem=replace(window.problem, disparity=left))
    assert found == pytest.approx(offset_px, abs=0.05)


def test_there_is_no_offset_without_noise() -> None:
    assert _estimate(_shifted(0.0, 0, noise=0.0)).value == pytest.approx(0.0, abs=1e-4)


def test_outliers_do_not_pass_for_an_offset() -> None:
    window = _shifted(0.0, 1)
    disparity = window.problem.disparity.copy()
    disparity[::20] += 5.0
    found = _estimate(replace(window, problem=replace(window.problem, disparity=disparity)))
    assert found.value == pytest.approx(0.0, abs=0.15)


def test_a_camera_that_stands_still_does_not_determine_it() -> None:
    window = drive(4, 100, stereo=True, fixed=1, step_m=1e-6)
    found = solve(window.problem, CONFIG).calibration_residual
    assert found is None or found.information[0, 0] < 0.2**-2


@pytest.mark.parametrize("curve_px", [-1.5, -0.5, 0.0, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_what_grows_towards_the_sides_is_told_from_an_offset(curve_px: float, seed: int) -> None:
    window = _shifted(0.3, seed)
    p = window.problem
    x = (p.xy[:, 0] - p.disparity - p.intrinsics[2]) / p.intrinsics[0]
    window = replace(window, problem=replace(p, disparity=p.disparity + curve_px * x**2))
    assert _estimate(window, 0).value == pytest.approx(0.3, abs=0.1)
    curve = _estimate(window, 1)
    assert curve.value == pytest.approx(curve_px, abs=max(0.15, 4.0 * curve.sigma))
    assert curve.sigma < 0.2


# The lens of a single camera


def _bent(k1: float, seed: int, noise: float = 0.2) -> Window:
    """Ideal points that lie at x (1 + k1 r^2), where the lens was taken to be straighter."""
    window = drive(10, 400, stereo=False, fixed=1, step_m=0.6)
    p = window.problem
    fx, fy, cx, cy = p.intrinsics
    ray = (p.xy - (cx, cy)) / (fx, fy)
    ray *= 1.0 + k1 * np.sum(ray**2, axis=1, keepdims=True)
    noisy = (
        ray * (fx, fy) + (cx, cy) + noise * np.random.default_rng(seed).standard_normal(ray.shape)
    )
    return replace(window, problem=replace(p, xy=noisy))


@pytest.mark.parametrize("k1", [-0.02, -0.005, 0.0, 0.01, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_k1_of_a_single_camera_is_found(k1: float, seed: int) -> None:
    found = _estimate(_bent(k1, seed))
    assert 0.0 < found.sigma < 0.004
    assert abs(found.value - k1) < max(4.0 * found.sigma, 0.1 * abs(k1))


@pytest.mark.parametrize("bend", [-0.05, 0.0, 0.03])
@pytest.mark.parametrize("seed", range(3))
def test_what_k1_cannot_explain_is_told_from_it(bend: float, seed: int) -> None:
    window = _bent(0.0, seed)
    p = window.problem
    fx, fy, cx, cy = p.intrinsics
    ray = (p.xy - (cx, cy)) / (fx, fy)
    ray *= 1.0 + 0.01 * np.sum(ray**2, axis=1, keepdims=True)
    ray *= 1.0 + bend * np.sum(ray**2, axis=1, keepdims=True) ** 2
    problem = replace(p, xy=ray * (fx, fy) + (cx, cy))
    found = solve(problem, CONFIG).calibration_residual
    assert found is not None
    assert abs(found.bend - bend) < max(4.0 * found.bend_sigma, 0.25 * abs(bend))
    assert found.bend_sigma < 0.02


@pytest.mark.parametrize("k1", [-0.1, 0.0, 0.02])
def test_an_error_of_both_lenses_of_a_pair_is_found(k1: float) -> None:
    window = _shifted(0.0, 1)
    p = window.problem
    fx, fy, cx, cy = p.intrinsics
    left = (p.xy - (cx, cy)) / (fx, fy)
    right = left - np.column_stack([p.disparity / fx, np.zeros(len(left))])
    bent, right_bent = (
        ray * (1.0 + k1 * np.sum(ray**2, axis=1, keepdims=True)) for ray in (left, right)
    )
    problem = replace(
        p,
        xy=bent * (fx, fy) + (cx, cy),
        disparity=fx * (bent[:, 0] - right_bent[:, 0]),
    )
    found = solve(problem, CONFIG).calibration_residual
    assert found is not None
    assert abs(found.bend - k1) < max(4.0 * found.bend_sigma, 0.3 * abs(k1))
    assert found.bend_sigma < 0.01


def test_noise_does_not_pass_for_an_error_of_the_lens() -> None:
    # Derivatives where points were measured, not where they should be, made it 0.0014.
    found = [_estimate(_bent(0.0, seed)).value for seed in range(20)]
    assert abs(np.mean(found)) < 0.0006


def test_a_lens_has_no_error_without_noise() -> None:
    assert _estimate(_bent(0.0, 0, noise=0.0)).value == pytest.approx(0.0, abs=1e-5)


def test_the_first_pose_s_missing_disparities_are_no_problem() -> None:
    window = _shifted(0.5, 2)
    disparity = np.where(window.problem.keyframe == 0, np.nan, window.problem.disparity)
    found = _estimate(replace(window, problem=replace(window.problem, disparity=disparity)))
    assert found.value == pytest.approx(0.5, abs=0.08)


def test_without_a_calibration_residual_the_solution_is_the_same() -> None:
    problem = _shifted(0.5, 0).problem
    with_residual = solve(problem, CONFIG)
    found = solve(replace(problem, estimates_calibration=False), CONFIG)
    assert with_residual.calibration_residual is not None
    assert found.calibration_residual is None
    np.testing.assert_array_equal(found.world_from_cam, with_residual.world_from_cam)
    np.testing.assert_array_equal(found.points, with_residual.points)
    np.testing.assert_array_equal(found.information, with_residual.information)
