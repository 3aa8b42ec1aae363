from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from windows import Window, drive

from vo.config import SmoothingConfig
from vo.smoothing.disparity_offset import DisparityOffset
from vo.smoothing.solution import smooth

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


def _estimate(window: Window) -> DisparityOffset:
    found = smooth(window.problem, CONFIG).offset
    assert found is not None
    return found


@pytest.mark.parametrize("offset_px", [-1.0, -0.3, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_an_offset_is_found_to_a_twentieth_of_a_pixel(offset_px: float, seed: int) -> None:
    found = _estimate(_shifted(offset_px, seed))
    # It is one linear step: of large offsets a little is left for the next window.
    assert found.offset_px == pytest.approx(offset_px, abs=max(0.05, 0.12 * abs(offset_px)))
    assert 0.0 < found.sigma_px < 0.1


@pytest.mark.parametrize("offset_px", [-1.0, 1.0, -2.5])
def test_what_is_left_of_large_offsets_is_found_in_the_next_step(offset_px: float) -> None:
    window, found = _shifted(offset_px, 0), 0.0
    for _ in range(2):
        step = _estimate(window).offset_px
        found += step
        left = window.problem.disparity - step
        window = replace(window, problem=replace(window.problem, disparity=left))
    assert found == pytest.approx(offset_px, abs=0.05)


def test_there_is_no_offset_without_noise() -> None:
    assert _estimate(_shifted(0.0, 0, noise=0.0)).offset_px == pytest.approx(0.0, abs=1e-4)


def test_outliers_do_not_pass_for_an_offset() -> None:
    window = _shifted(0.0, 1)
    disparity = window.problem.disparity.copy()
    disparity[::20] += 5.0
    found = _estimate(replace(window, problem=replace(window.problem, disparity=disparity)))
    assert found.offset_px == pytest.approx(0.0, abs=0.15)


def test_a_camera_that_stands_still_does_not_determine_it() -> None:
    window = drive(4, 100, stereo=True, fixed=1, step_m=1e-6)
    found = smooth(window.problem, CONFIG).offset
    assert found is None or found.sigma_px > 0.2


def test_the_first_pose_s_missing_disparities_are_no_problem() -> None:
    window = _shifted(0.5, 2)
    disparity = np.where(window.problem.keyframe == 0, np.nan, window.problem.disparity)
    found = _estimate(replace(window, problem=replace(window.problem, disparity=disparity)))
    assert found.offset_px == pytest.approx(0.5, abs=0.08)
