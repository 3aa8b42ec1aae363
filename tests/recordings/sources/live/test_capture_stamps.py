"""Stamps of live images, from a stream's own times and from arrival."""

from __future__ import annotations

import time

import numpy as np
import pytest

from vo.recordings.sources.live.clock import CaptureStamps, HostClock

FRAME_NS = 33_333_333
START_NS = 1_700_000_000_000_000_000


def stamps_of(arrivals_ns: list[int], own_ns: list[int | None]) -> np.ndarray:
    stamps = CaptureStamps()
    pairs = zip(arrivals_ns, own_ns, strict=True)
    return np.array([stamps.stamp(arrival, own) for arrival, own in pairs])


def arrivals(count: int, jitter_ns: int, rate_error: float = 0.0) -> list[int]:
    """Frames that arrive up to `jitter_ns` late, never in another order."""
    rng = np.random.default_rng(0)
    times = START_NS + np.arange(count) * round(FRAME_NS * (1 + rate_error))
    return np.maximum.accumulate(
        times + rng.integers(0, jitter_ns, count) + np.arange(count)
    ).tolist()


def test_own_times_make_regular_stamps_of_late_arrivals() -> None:
    late = arrivals(600, 15_000_000)
    stamps = stamps_of(late, [12_345 + i * FRAME_NS for i in range(600)])
    assert (stamps <= np.array(late)).all()
    errors_ms = np.abs(np.diff(stamps)[30:] - FRAME_NS) * 1e-6
    assert np.percentile(errors_ms, 95) < 0.01
    assert errors_ms.max() < 1.0
    assert np.diff(np.array(late)).std() * 1e-6 > 5.0  # without own times


def test_stamps_follow_a_camera_whose_clock_is_slow() -> None:
    """After an hour at 100 ppm, the minimum since the beginning would be 360 ms too early."""
    count = 3600 * 30
    exact = arrivals(count, 1, rate_error=1e-4)
    stamps = stamps_of(exact, [i * FRAME_NS for i in range(count)])
    assert (np.array(exact) - stamps).max() < 3_000_000


@pytest.mark.parametrize("own", ["missing", "constant", "backwards", "slow"])
def test_arrival_replaces_own_times_that_are_wrong(own: str) -> None:
    times: dict[str, list[int | None]] = {
        "missing": [None] * 100,
        "constant": [7] * 100,
        "backwards": [(100 - i) * FRAME_NS for i in range(100)],
        "slow": [i * 1000 for i in range(100)],
    }
    exact = arrivals(100, 1)
    stamps = stamps_of(exact, times[own])
    assert (np.diff(stamps) > 0).all()
    assert (np.array(exact) - stamps).max() < 1_000_000_000
    if own != "slow":
        assert (np.array(exact) - stamps).max() < FRAME_NS


def test_a_stream_that_begins_again_gets_increasing_stamps() -> None:
    exact = arrivals(200, 1)
    own: list[int | None] = [(i if i < 100 else i - 100) * FRAME_NS for i in range(200)]
    stamps = stamps_of(exact, own)
    assert np.allclose(stamps, exact, rtol=0, atol=1000)


def test_the_clock_is_that_of_the_host() -> None:
    clock = HostClock()
    assert abs(clock.now_ns() - time.time_ns()) < 1_000_000_000
    assert clock.of_monotonic(time.monotonic_ns()) <= clock.now_ns()


def test_images_that_come_later_and_later_are_noticed() -> None:
    slow, drifting = CaptureStamps(), CaptureStamps()
    for i in range(3600 * 30):
        drifting.stamp(START_NS + round(i * FRAME_NS * (1 + 1e-4)), i * FRAME_NS)
    assert drifting.lag_ns == 0
    for i in range(300):  # decoded at 25 frames/s
        slow.stamp(START_NS + i * 40_000_000, i * FRAME_NS)
    assert slow.lag_ns == pytest.approx(300 * (40_000_000 - FRAME_NS), rel=0.02)
