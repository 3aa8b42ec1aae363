"""Samples of an inertial sensor between two frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from inertial_flight import START_NS, Samples, Sensor, sensor

from vo.engine.inertial.samples import SampleReader

_MS = 1_000_000


def _line(stamps_ns: np.ndarray) -> Sensor:
    """A sensor whose values grow by 1 a second."""
    values = 1e-9 * (stamps_ns - START_NS)[:, None] * np.ones((1, 3))
    return Sensor(Samples(stamps_ns, values, 10.0 + values))


def _stamps(count: int = 4000) -> np.ndarray:
    return START_NS + np.arange(count) * 5 * _MS


def test_values_at_both_ends_are_interpolated() -> None:
    reader = SampleReader(_line(_stamps()))
    found = reader.between(START_NS + 12 * _MS, START_NS + 33 * _MS)
    assert found is not None
    np.testing.assert_allclose(found.seconds, [0.0, 0.003, 0.008, 0.013, 0.018, 0.021], atol=1e-12)
    np.testing.assert_allclose(found.gyro[:, 1], 0.012 + found.seconds, atol=1e-12)
    np.testing.assert_allclose(found.accel[:, 2], 10.012 + found.seconds, atol=1e-12)


def test_ends_at_samples_have_their_values() -> None:
    found = SampleReader(_line(_stamps())).between(START_NS + 10 * _MS, START_NS + 20 * _MS)
    assert found is not None
    np.testing.assert_allclose(found.seconds, [0.0, 0.005, 0.01], atol=1e-15)
    np.testing.assert_allclose(found.gyro[:, 0], [0.01, 0.015, 0.02], atol=1e-15)


def test_times_between_two_samples_give_two_values() -> None:
    found = SampleReader(_line(_stamps())).between(START_NS + 11 * _MS, START_NS + 13 * _MS)
    assert found is not None
    np.testing.assert_allclose(found.gyro[:, 0], [0.011, 0.013], atol=1e-15)


def test_intervals_join_across_the_blocks_that_are_read() -> None:
    reader, source = SampleReader(_line(_stamps())), _line(_stamps())
    for begin_s in (0.5, 9.0, 9.9, 10.4, 15.0):
        begin = START_NS + int(begin_s * 1e9)
        found = reader.between(begin, begin + 800 * _MS)
        fresh = SampleReader(source).between(begin, begin + 800 * _MS)
        assert found is not None and fresh is not None
        np.testing.assert_array_equal(found.gyro, fresh.gyro)
        assert found.duration_s == 0.8


def test_stamps_of_images_are_moved_to_the_clock_of_the_sensor() -> None:
    late = replace(_line(_stamps()), time_offset_s=0.004)
    found = SampleReader(late).between(START_NS + 11 * _MS, START_NS + 13 * _MS)
    assert found is not None
    np.testing.assert_allclose(found.gyro[:, 0], [0.015, 0.017], atol=1e-12)


def test_missing_samples_give_nothing() -> None:
    stamps = _stamps()
    with_gap = stamps[(stamps < START_NS + 1000 * _MS) | (stamps > START_NS + 1150 * _MS)]
    reader = SampleReader(_line(with_gap))
    assert reader.between(START_NS + 900 * _MS, START_NS + 1200 * _MS) is None
    assert reader.between(START_NS + 1200 * _MS, START_NS + 1300 * _MS) is not None
    assert reader.between(START_NS - 10 * _MS, START_NS + 10 * _MS) is None
    assert reader.between(int(stamps[-1]) - _MS, int(stamps[-1]) + _MS) is None
    assert reader.between(START_NS + 5 * _MS, START_NS + 5 * _MS) is None
    assert SampleReader(sensor(seconds=1.0)).between(START_NS, START_NS + 10**10) is None
