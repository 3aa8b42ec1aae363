"""Which frames are expected to become keyframes before they are tracked."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.config import KeyframeConfig
from vo.engine.tracking.keyframe_policy import Change, KeyframeForecast, KeyframePolicy

CONFIG = KeyframeConfig(min_tracked_ratio=0.75, min_parallax_deg=1.5, max_gap_s=1.0)


def _change(tracked: int, parallax_deg: float = 0.0, elapsed_s: float = 0.1) -> Change:
    return Change(tracked, 1000, float(np.deg2rad(parallax_deg)), elapsed_s)


@pytest.fixture
def forecast() -> KeyframeForecast:
    forecast = KeyframeForecast(KeyframePolicy(CONFIG, max_landmarks=1000))
    forecast.expects_next(_change(700), is_keyframe=True)
    return forecast


def test_landmarks_that_are_lost_evenly(forecast: KeyframeForecast) -> None:
    expected = [
        forecast.expects_next(_change(tracked), is_keyframe=False)
        for tracked in (960, 890, 820, 760)
    ]
    assert expected == [False, False, False, True]  # 890, 820, 750 and 700 would come next


def test_a_turn_that_goes_on(forecast: KeyframeForecast) -> None:
    expected = [
        forecast.expects_next(_change(1000, parallax_deg=deg), is_keyframe=False)
        for deg in (0.4, 0.8, 1.1, 1.35)
    ]
    assert expected == [False, False, False, True]


def test_time_that_runs_out_in_motion(forecast: KeyframeForecast) -> None:
    expected = [
        forecast.expects_next(_change(1000, 0.4, elapsed_s), is_keyframe=False)
        for elapsed_s in (0.3, 0.6, 0.9)
    ]
    assert expected == [False, False, True]


def test_every_second_frame(forecast: KeyframeForecast) -> None:
    expected = []
    for _ in range(4):
        expected.append(forecast.expects_next(_change(800), is_keyframe=False))
        expected.append(forecast.expects_next(_change(600), is_keyframe=True))
    assert expected == [False, False, True, False, True, False, True, False]
    assert not forecast.expects_all


def test_every_frame(forecast: KeyframeForecast) -> None:
    expected = [forecast.expects_next(_change(700), is_keyframe=True) for _ in range(8)]
    assert expected[2:] == [True] * 6
    assert forecast.expects_all


def test_none_for_a_still_camera(forecast: KeyframeForecast) -> None:
    assert not any(
        forecast.expects_next(_change(1000, 0.01, 0.1 * k), is_keyframe=False)
        for k in range(1, 200)
    )
