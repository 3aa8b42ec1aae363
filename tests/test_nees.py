"""NEES of keyframes and steps, as `scripts/nees` measures them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.types import Floats, KeyframePose

SIGMA = 0.01


@pytest.fixture(scope="module")
def nees() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parent.parent / "scripts"))
        yield importlib.import_module("nees")
    sys.modules.pop("nees")


class IndependentKeyframes:
    """Joint covariance of keyframes without shared errors; the first one is exact."""

    def block(self, row: int, column: int) -> Floats:
        return SIGMA**2 * np.eye(6) * (row == column and row > 0)


def keyframe(number: int, pose: Floats) -> KeyframePose:
    covariance = SIGMA**2 * np.eye(6)
    return KeyframePose(number, number, 0, pose, covariance if number else np.zeros((6, 6)))


def found(nees: ModuleType, errors: Floats, mono: bool = False, scale: float = 1.0) -> Any:
    """Pairs of ten keyframes along a straight line with these errors (10, 6)."""
    true = np.tile(np.eye(4), (10, 1, 1))
    true[:, 0, 3] = np.arange(10)
    estimated = true @ inverse(np.stack([se3_exp(error) for error in errors]))
    estimated[:, :3, 3] *= scale
    keyframes = [keyframe(k, pose) for k, pose in enumerate(estimated)]
    return nees.pairs(keyframes, np.arange(10), true, IndependentKeyframes(), mono)


def test_nees_is_the_squared_error_in_standard_deviations(nees: ModuleType) -> None:
    errors = np.zeros((10, 6))
    errors[1:, 3] = 2 * SIGMA  # along x, as the path
    pairs = found(nees, errors)
    assert [pair.nees for pair in pairs[0]] == pytest.approx([4.0] * 9)
    # The first step has one error of 2 sigma, the others have the difference of equal errors.
    assert [pair.nees for pair in pairs[1]] == pytest.approx([4.0] + [0.0] * 8, abs=1e-9)


def test_the_scale_of_mono_is_taken_from_the_first_keyframes(nees: ModuleType) -> None:
    pairs = found(nees, np.zeros((10, 6)), mono=True, scale=0.25)
    assert max(pair.nees for pair in pairs[0]) < 1e-9
    assert pairs[0][0].covariance[3, 3] == pytest.approx((4 * SIGMA) ** 2)


def test_a_cell_marks_covariances_that_are_too_large_or_too_small(nees: ModuleType) -> None:
    def pairs(value: float) -> list[Any]:
        return [nees.Pair(np.full(6, np.sqrt(value / 6)), np.eye(6))] * 50

    assert nees.cell(pairs(6.0), 1) == "6.0 ✓"
    assert nees.cell(pairs(3.0), 1) == "3.0 too large"
    assert nees.cell(pairs(12.0), 1) == "12.0 too small"
    assert nees.cell(pairs(3.0), 20) == "3.0 ✓"  # only two independent steps
    assert nees.cell([], 1) == "–"


def test_measures_a_recording(nees: ModuleType, synthetic_stereo: Path) -> None:
    config = load_config("fast", ["keyframes.min_parallax_deg=0.2"])
    count, pairs = nees.measure(synthetic_stereo, "stereo", config)
    assert count >= nees.MIN_KEYFRAMES
    assert len(pairs[0]) >= nees.MIN_KEYFRAMES - 1
    assert len(pairs[1]) >= nees.MIN_KEYFRAMES - 1
    assert 0.01 < np.mean([pair.nees for pair in pairs[1]]) < 60.0
