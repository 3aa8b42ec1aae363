"""Which tracked frames become keyframes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vo.base.config import KeyframeConfig, load_config
from vo.engine.tracking.keyframe_policy import (
    Change,
    KeyframeForecast,
    KeyframePolicy,
    median_parallax,
)

CONFIG = load_config("fast")
MOST = CONFIG.tracking.max_landmarks
POLICY = KeyframePolicy(CONFIG.keyframes, MOST)


def _becomes_keyframe(observed_by_last: int, tracked: int, turned_px: float = 0.0) -> bool:
    """Of a camera that stands still, or turns."""
    last = SimpleNamespace(
        landmark=np.arange(observed_by_last),
        image_xy=np.zeros((observed_by_last, 2)),
        world_from_cam=np.eye(4),
        frame=SimpleNamespace(stamp_ns=1_000_000_000),
    )
    xyz = np.tile([0.0, 0.0, 5.0], (observed_by_last, 1))
    local_map: Any = SimpleNamespace(keyframes=[last], xyz=xyz)
    rows, inlier = np.arange(tracked), np.ones(tracked, dtype=bool)
    observed = SimpleNamespace(rows=rows, image_xy=np.full((tracked, 2), turned_px))
    found: Any = SimpleNamespace(
        world_from_cam=np.eye(4), observed=observed, inlier=inlier, ids=rows
    )
    frame: Any = SimpleNamespace(stamp_ns=1_050_000_000)
    return POLICY.needs_keyframe(POLICY.change_since_last(local_map, frame, found))


@pytest.mark.parametrize("observed_by_last", [MOST, 2 * MOST, 4 * MOST])
def test_still_camera_makes_no_keyframe_however_rich_the_scene(observed_by_last: int) -> None:
    assert not _becomes_keyframe(observed_by_last, round(0.97 * MOST))


@pytest.mark.parametrize("observed_by_last", [round(0.8 * MOST), 2 * MOST])
def test_camera_that_has_lost_half_of_its_landmarks_makes_a_keyframe(observed_by_last: int) -> None:
    assert _becomes_keyframe(observed_by_last, round(0.4 * MOST), turned_px=2.0)


def test_what_hides_landmarks_from_a_camera_at_rest_does_not_become_a_part_of_the_map() -> None:
    assert not _becomes_keyframe(MOST, round(0.4 * MOST), turned_px=0.1)


STRICT = KeyframeConfig(
    min_tracked_ratio=0.75, min_tracked=200, min_parallax_deg=1.5, max_gap_s=1.0
)


def _needs_keyframe(change: Change, config: KeyframeConfig = STRICT) -> bool:
    return KeyframePolicy(config, max_landmarks=1000).needs_keyframe(change)


@pytest.mark.parametrize(
    ("tracked", "parallax_deg", "elapsed_s", "needed"),
    [
        (900, 0.5, 0.5, False),
        (740, 0.0, 0.0, True),
        (760, 0.0, 0.0, False),
        (900, 1.6, 0.1, True),
        (900, 1.4, 0.1, False),
        (900, 0.5, 1.0, True),
        (900, 0.0, 60.0, False),
    ],
)
def test_keyframes_come_with_lost_landmarks_parallax_or_time_in_motion(
    tracked: int, parallax_deg: float, elapsed_s: float, needed: bool
) -> None:
    parallax = np.deg2rad(parallax_deg)
    assert _needs_keyframe(Change(tracked, 1000, parallax, elapsed_s)) == needed


@pytest.mark.parametrize(("parallax_deg", "needed"), [(0.0, False), (0.2, False), (0.5, True)])
def test_few_landmarks_ask_for_a_keyframe_once_the_camera_has_moved(
    parallax_deg: float, needed: bool
) -> None:
    assert _needs_keyframe(Change(150, 160, np.deg2rad(parallax_deg), 0.1)) == needed


@pytest.mark.parametrize(("parallax_deg", "needed"), [(1.6, False), (2.4, False), (2.6, True)])
def test_a_single_camera_waits_for_more_parallax(parallax_deg: float, needed: bool) -> None:
    mono = KeyframeConfig(min_parallax_deg=1.5, min_parallax_mono_deg=2.5).in_mono()
    assert _needs_keyframe(Change(900, 1000, np.deg2rad(parallax_deg), 0.1), mono) == needed


def test_parallax_is_the_median_angle_at_the_points() -> None:
    points = np.array([[0.5, 0.0, np.sqrt(0.75)], [0.5, 0.0, 0.5], [0.5, 0.0, 1e6]])
    found = median_parallax(points, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    assert np.rad2deg(found) == pytest.approx(60.0)


def test_parallax_is_none_without_points_or_without_motion() -> None:
    points = np.random.default_rng(0).uniform(1, 5, (20, 3))
    centre = np.array([0.1, 0.2, 0.3])
    assert median_parallax(points[:0], centre, centre + 1.0) == 0.0
    assert median_parallax(points, centre, centre) == pytest.approx(0.0, abs=1e-6)


def test_a_point_at_the_camera_centre_does_no_harm() -> None:
    points = np.zeros((1, 3))
    assert np.isfinite(median_parallax(points, np.zeros(3), np.ones(3)))


FORECAST_CONFIG = KeyframeConfig(min_tracked_ratio=0.75, min_parallax_deg=1.5, max_gap_s=1.0)


def _change(tracked: int, parallax_deg: float = 0.0, elapsed_s: float = 0.1) -> Change:
    return Change(tracked, 1000, float(np.deg2rad(parallax_deg)), elapsed_s)


@pytest.fixture
def forecast() -> KeyframeForecast:
    forecast = KeyframeForecast(KeyframePolicy(FORECAST_CONFIG, max_landmarks=1000))
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
