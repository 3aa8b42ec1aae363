from __future__ import annotations

import numpy as np
import pytest

from data_synth.recipe import Effects
from data_synth.sensor.kidnapping import Kidnapping, kidnap, path_seconds
from vo.base.types import Floats

SECONDS = 40.0
TIMES_S = np.arange(400) / 10.0


def _along_a_line(times_s: Floats) -> Floats:
    return np.column_stack([times_s, np.zeros((len(times_s), 2))])


def _kidnapped(times: int, black: int = 3, seed: int = 1) -> Kidnapping:
    effects = Effects(kidnap=times, kidnap_black=black)
    return kidnap(effects, TIMES_S, SECONDS, _along_a_line, seed)


def test_without_kidnapping_frames_are_at_their_own_times() -> None:
    result = _kidnapped(0)
    np.testing.assert_array_equal(result.path_s, TIMES_S)
    assert not result.black.any()
    assert path_seconds(Effects(), SECONDS) == SECONDS


@pytest.mark.parametrize("times", [1, 2, 5])
def test_camera_goes_on_where_it_was_taken_from(times: int) -> None:
    path_s = _kidnapped(times).path_s
    jumps = np.flatnonzero(np.abs(np.diff(path_s) - 0.1) > 1e-6)
    assert len(jumps) == 2 * times
    for taken, returned in jumps.reshape(-1, 2):
        assert path_s[returned + 1] == pytest.approx(path_s[taken] + 0.1, abs=0.1 + 1e-6)
        assert abs(path_s[taken + 1] - path_s[taken]) > 5.0  # elsewhere is far away
    assert path_s.min() >= 0.0
    assert path_s.max() <= path_seconds(Effects(kidnap=times), SECONDS)


def test_a_quarter_of_the_frames_is_elsewhere() -> None:
    path_s = _kidnapped(2).path_s
    jumps = np.flatnonzero(np.abs(np.diff(path_s) - 0.1) > 1e-6)
    assert sum(np.diff(jumps)[::2]) == pytest.approx(100, abs=2)


@pytest.mark.parametrize("black", [0, 3])
def test_frames_are_black_while_the_camera_is_carried(black: int) -> None:
    result = _kidnapped(2, black)
    assert result.black.sum() == 4 * black
    jumps = np.flatnonzero(np.abs(np.diff(result.path_s) - 0.1) > 1e-6)
    for jump in jumps:
        assert result.black[jump + 1 : jump + 1 + black].all()
        assert not result.black[jump]


def test_other_places_depend_on_the_seed_only() -> None:
    np.testing.assert_array_equal(_kidnapped(2).path_s, _kidnapped(2).path_s)
    assert not np.array_equal(_kidnapped(2).path_s, _kidnapped(2, seed=2).path_s)
