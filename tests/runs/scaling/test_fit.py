"""The robust similarity to positions: exact without errors, honest with them."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.transforms import so3_exp
from vo.base.types import Floats
from vo.runs.scaling.fit import fit_positions

SCALE = 3.7
ROTATION = so3_exp(np.array([0.4, -1.1, 0.3]))
SHIFT = np.array([120.0, -40.0, 7.0])


def drive(count: int, length_m: float) -> Floats:
    """A drive with a turn by 90 degrees in its middle."""
    part = np.linspace(0.0, 1.0, count)
    half = np.column_stack(
        [np.maximum(part - 0.5, 0.0), 0.01 * np.sin(9 * part), np.minimum(part, 0.5)]
    )
    return np.asarray(length_m * half)


def seconds(positions: Floats) -> Floats:
    """Times (N,) of 10 Hz."""
    return np.asarray(0.1 * np.arange(len(positions)))


def correlated(rng: np.random.Generator, count: int, lags: float) -> Floats:
    """Errors of unit variance (N, 3) that are correlated over so many positions."""
    kept = np.exp(-1.0 / lags)
    errors = rng.normal(size=(count, 3))
    for row in range(1, count):
        errors[row] = kept * errors[row - 1] + np.sqrt(1.0 - kept**2) * errors[row]
    return errors


def test_exact_without_errors() -> None:
    metres = drive(50, 80.0)
    fit = fit_positions(seconds(metres), metres / SCALE, metres @ ROTATION.T + SHIFT)
    assert fit is not None
    assert fit.scale == pytest.approx(SCALE, rel=1e-9)
    np.testing.assert_allclose(fit.rotation, ROTATION, atol=1e-9)
    np.testing.assert_allclose(fit.translation, SHIFT, atol=1e-6)
    assert fit.used.all() and fit.jumps == 0


@pytest.mark.parametrize(
    ("kind", "count", "max_error"),
    [("white", 100, 0.012), ("white", 20, 0.03), ("drift", 100, 0.08)],
)
def test_the_uncertainty_covers_the_truth(kind: str, count: int, max_error: float) -> None:
    """2 m of noise over 200 m: right within 1 %, and 95 % of 40 runs within 1.96 sigma."""
    metres, covered, errors = drive(count, 200.0), 0, []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = (
            rng.normal(size=(count, 3)) if kind == "white" else correlated(rng, count, count / 20)
        )
        fit = fit_positions(
            seconds(metres), metres / SCALE, metres @ ROTATION.T + SHIFT + 2.0 * noise
        )
        assert fit is not None
        error = fit.scale / SCALE - 1.0
        errors.append(error)
        covered += abs(error) <= 1.96 * fit.sigma / SCALE
        assert fit.sigma / SCALE < max_error  # it is not covered by being huge
    assert covered >= 36  # 90 %: fewer than one time in 20 if 95 % are right
    assert np.sqrt(np.mean(np.square(errors))) < max_error / 2


@pytest.mark.parametrize(("lags", "share"), [(50, 0.0), (100, 0.0), (100, 0.5), (300, 0.0)])
def test_errors_as_slow_as_the_path_are_allowed_for(lags: float, share: float) -> None:
    """Alone or under white noise of the same size: they hide in the similarity."""
    metres, covered = drive(100, 200.0), 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        slow, white = correlated(rng, 100, lags), rng.normal(size=(100, 3))
        noise = 2.0 * (np.sqrt(1.0 - share) * slow + np.sqrt(share) * white)
        fit = fit_positions(seconds(metres), metres / SCALE, metres @ ROTATION.T + SHIFT + noise)
        assert fit is not None
        covered += abs(fit.scale / SCALE - 1.0) <= 1.96 * fit.sigma / SCALE
    assert covered >= 16  # of 20; 14 if the correlation of the residuals is taken as it is


@pytest.mark.parametrize("ratio", [0.1, 0.3])
def test_outliers_are_refused(ratio: float) -> None:
    rng = np.random.default_rng(3)
    metres = drive(120, 200.0)
    positions = metres @ ROTATION.T + SHIFT + rng.normal(0.0, 1.0, (120, 3))
    wrong = rng.permutation(120)[: round(120 * ratio)]
    positions[wrong] += rng.normal(0.0, 80.0, (len(wrong), 3))
    fit = fit_positions(seconds(metres), metres / SCALE, positions)
    assert fit is not None
    far = np.linalg.norm(positions - metres @ ROTATION.T - SHIFT, axis=1) > 10.0
    assert not fit.used[far].any()
    assert fit.used[np.setdiff1d(np.arange(120), wrong)].mean() > 0.97
    assert abs(fit.scale / SCALE - 1.0) < max(0.01, 3.0 * fit.sigma / SCALE)


@pytest.mark.parametrize("first", [30, 60, 100])
def test_a_jump_is_found_and_each_part_placed(first: int) -> None:
    rng = np.random.default_rng(first)
    metres = drive(120, 200.0)
    positions = metres @ ROTATION.T + SHIFT + rng.normal(0.0, 1.0, (120, 3))
    positions[first:] += (30.0, -20.0, 5.0)
    fit = fit_positions(seconds(metres), metres / SCALE, positions)
    assert fit is not None and fit.jumps == 1
    assert abs(fit.scale / SCALE - 1.0) < min(0.03, 3.0 * fit.sigma / SCALE)


def test_no_jump_without_one() -> None:
    """No false alarm over 40 clean drives."""
    metres = drive(100, 200.0)
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0.0, 2.0, (100, 3))
        fit = fit_positions(seconds(metres), metres / SCALE, metres + noise)
        assert fit is not None and fit.jumps == 0 and fit.used.mean() > 0.97


def test_positions_that_do_not_move_say_nothing() -> None:
    rng = np.random.default_rng(0)
    fit = fit_positions(np.arange(60.0), drive(60, 1.0), rng.normal(0.0, 2.0, (60, 3)))
    assert fit is None or fit.sigma > 0.1 * fit.scale
    assert fit_positions(np.arange(20.0), np.zeros((20, 3)), rng.normal(size=(20, 3))) is None
    assert fit_positions(np.arange(4.0), drive(4, 10.0), drive(4, 10.0)) is None


def test_known_deviations_are_weights() -> None:
    rng = np.random.default_rng(5)
    metres = drive(200, 100.0)
    sigma = np.where(np.arange(200) % 2 == 0, 0.1, 10.0)
    positions = metres + sigma[:, None] * rng.normal(size=(200, 3))
    weighted, plain = (
        fit_positions(seconds(metres), metres, positions, sigma),
        fit_positions(seconds(metres), metres, positions),
    )
    assert weighted is not None and plain is not None
    assert abs(weighted.scale - 1.0) < 0.003
    assert weighted.sigma < 0.005
