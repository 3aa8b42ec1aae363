"""The time offset between camera and inertial sensor, by the rotations of a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inertial_flight import START_NS, Samples, Sensor, sensor, world_from_cam

from vo.base.types import Floats, Ints
from vo.engine.geometry import so3
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.time_offset import (
    OffsetSearch,
    TimeOffset,
    measure_time_offset,
    regular_stamps,
)

_FRAMES = START_NS + 200_000_000 + np.arange(280) * 50_000_000  # 14 s


def _rotations(noise_rad: float = 3e-5) -> Floats:
    """By images, with errors that differ from frame to frame."""
    rng = np.random.default_rng(5)
    true = world_from_cam(_FRAMES)[:, :3, :3]
    return np.asarray(true @ so3.exp(noise_rad * rng.standard_normal((len(true), 3))))


def _late(source: Sensor, offset_s: float) -> Sensor:
    """The same sensor with a clock that is ahead of that of the images."""
    samples = source.samples
    return replace(
        source, samples=replace(samples, stamps_ns=samples.stamps_ns + round(1e9 * offset_s))
    )


def _one_segment(stamps_ns: Ints = _FRAMES) -> Ints:
    return np.zeros(len(stamps_ns), np.int64)


@pytest.mark.parametrize("offset_s", [-0.35, -0.05, -0.013, 0.0, 0.004, 0.05, 0.2])
def test_offsets_are_found_within_a_millisecond(offset_s: float) -> None:
    source = _late(sensor(noise=1.0), offset_s)
    found = measure_time_offset(_FRAMES, _one_segment(), _rotations(), SampleReader(source))
    assert found is not None
    assert abs(found.seconds - offset_s) < min(0.001, 4.0 * found.sigma_s)
    assert 0.0 < found.sigma_s < 0.0005


def test_offset_is_searched_around_the_given_one() -> None:
    source = replace(_late(sensor(noise=1.0), 0.16), time_offset_s=0.15)
    found = measure_time_offset(_FRAMES, _one_segment(), _rotations(), SampleReader(source))
    assert found is not None and abs(found.seconds - 0.16) < 0.001


def test_rotations_across_segments_are_not_used() -> None:
    rotations = _rotations()
    half = len(rotations) // 2
    turn = so3.exp(np.array([0.0, 0.0, 2.0]))
    rotations[half:] = turn @ rotations[half:]  # another world
    segments = np.repeat([0, 1], [half, len(rotations) - half])
    source = _late(sensor(noise=1.0), 0.02)
    found = measure_time_offset(_FRAMES, segments, rotations, SampleReader(source))
    assert found is not None and abs(found.seconds - 0.02) < 0.001
    assert (
        measure_time_offset(_FRAMES, np.arange(len(_FRAMES)), rotations, SampleReader(source))
        is None
    )


def test_long_runs_are_thinned_out() -> None:
    source = _late(sensor(noise=1.0, seconds=22.0), 0.02)
    stamps = START_NS + 200_000_000 + np.arange(10_000) * 2_000_000
    true = world_from_cam(stamps)[:, :3, :3]
    found = measure_time_offset(stamps, _one_segment(stamps), true, SampleReader(source))
    assert found is not None and abs(found.seconds - 0.02) < 5e-4


def test_sensor_with_other_axes_or_a_camera_at_rest_gives_none() -> None:
    source = sensor(noise=1.0)
    given = source.samples
    turned = Samples(given.stamps_ns, given.gyro * [-1.0, -1.0, 1.0], given.accel)
    mirrored = Samples(given.stamps_ns, given.gyro * [1.0, 1.0, -1.0], given.accel)
    for samples in (turned, mirrored):
        wrong = replace(source, samples=samples)
        assert (
            measure_time_offset(_FRAMES, _one_segment(), _rotations(), SampleReader(wrong)) is None
        )
    still = np.tile(np.eye(3), (len(_FRAMES), 1, 1))
    assert measure_time_offset(_FRAMES, _one_segment(), still, SampleReader(source)) is None


def test_only_certain_differences_replace_the_given_offset() -> None:
    assert not TimeOffset(0.0009, 1e-5).differs_from(0.0)
    assert not TimeOffset(0.004, 0.001).differs_from(0.0)
    assert TimeOffset(0.006, 0.001).differs_from(0.0)
    right, wrong = (SampleReader(_late(sensor(noise=1.0), offset)) for offset in (0.0, 0.03))
    assert not OffsetSearch(right).measure(_FRAMES, _one_segment(), _rotations())
    assert right.time_offset_s == 0.0
    assert OffsetSearch(wrong).measure(_FRAMES, _one_segment(), _rotations())
    assert abs(wrong.time_offset_s - 0.03) < 0.001


def test_readers_follow_the_replaced_offset() -> None:
    reader = SampleReader(sensor())
    first, last = START_NS + 10_000_000, START_NS + 60_000_000
    reader.between(first, last)
    reader.time_offset_s = 0.02
    moved, expected = (
        reader.between(first, last),
        SampleReader(sensor()).between(first + 20_000_000, last + 20_000_000),
    )
    assert moved is not None and expected is not None
    np.testing.assert_array_equal(moved.gyro, expected.gyro)


def test_offset_is_measured_rarely_and_no_longer_with_states() -> None:
    search = OffsetSearch(SampleReader(sensor()))
    assert not search.is_due(39, has_states=False)
    due = [n for n in range(40, 400) if search.is_due(n, has_states=False)]
    assert due == [40, 80, 160, 320]
    assert search.is_due(401, has_states=True)
    assert not search.is_due(1000, has_states=True)


def test_stamps_that_vary_give_the_regular_times_of_the_camera() -> None:
    rng = np.random.default_rng(1)
    number = np.flatnonzero(rng.random(400) > 0.05)  # lost frames
    exact = START_NS + np.rint(number * 83_333_333 * (1.0 + 1e-5 * number / 400)).astype(np.int64)
    found = regular_stamps(exact + np.rint(2e6 * rng.standard_normal(len(exact))).astype(np.int64))
    assert found is not None
    assert np.std(found - exact) < 0.5e6


def test_exact_stamps_and_those_of_an_irregular_camera_have_no_other_times() -> None:
    rng = np.random.default_rng(2)
    assert regular_stamps(_FRAMES) is None
    steps = rng.uniform(30e6, 150e6, 300).astype(np.int64)
    assert regular_stamps(START_NS + np.cumsum(steps)) is None
