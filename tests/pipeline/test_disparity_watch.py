from __future__ import annotations

import numpy as np
import pytest

from vo.pipeline.disparity_watch import DisparityWatch
from vo.smoothing.miscalibration import Miscalibration


def _corrections(offsets: list[float], sigma: float = 0.02) -> list[tuple[int, float]]:
    """Number of the window and offset of each correction; what is corrected is seen no more."""
    watch, found = DisparityWatch(), []
    for i, offset in enumerate(offsets):
        wanted = watch.update(Miscalibration(offset - watch.applied_px, sigma))
        if wanted is not None:
            found.append((i, wanted))
    return found


@pytest.mark.parametrize("offset", [-0.8, -0.22, 0.3])
def test_a_large_offset_is_corrected_at_the_third_window(offset: float) -> None:
    (number, wanted), *_ = _corrections([offset] * 20)
    assert number == 2
    assert wanted == pytest.approx(offset, abs=1e-9)


@pytest.mark.parametrize("offset", [-0.15, 0.14])
def test_a_small_offset_is_corrected_when_it_has_lasted(offset: float) -> None:
    (number, wanted), *_ = _corrections([offset] * 40)
    assert 5 < number < 30
    assert wanted == pytest.approx(offset, abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_what_windows_differ_by_is_no_offset(seed: int) -> None:
    # Slow waves about nothing; a real recording without an offset has some twice as high.
    waves = np.repeat(np.random.default_rng(seed).normal(0.0, 0.05, 30), 10)
    assert _corrections(waves.tolist()) == []


def test_a_wave_that_passed_for_an_offset_is_taken_back() -> None:
    found = _corrections([0.25] * 10 + [-0.05] * 40)
    assert found[0] == (2, pytest.approx(0.25))
    assert found[-1][1] == 0.0


def test_less_than_a_tenth_of_a_pixel_is_never_corrected() -> None:
    assert _corrections([0.09] * 500) == []
