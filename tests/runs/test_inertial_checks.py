"""Inertial sensors that cannot be used are told from those that can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inertial_flight import START_NS, Samples, Sensor, sensor

from vo.base.types import Floats
from vo.runs.inertial_checks import why_unusable

_IMAGES_NS = START_NS + np.arange(300) * 50_000_000


def _scaled(gyro: float, accel: float) -> Sensor:
    good = sensor(seconds=16.0)
    given = good.samples
    return replace(good, samples=Samples(given.stamps_ns, gyro * given.gyro, accel * given.accel))


def test_a_good_sensor_is_used() -> None:
    assert why_unusable(sensor(seconds=16.0, noise=1.0), _IMAGES_NS) is None


@pytest.mark.parametrize(
    ("gyro", "accel", "words"),
    [
        (1.0, 1 / 9.80665, "probably in g"),
        (57.3, 1.0, "probably degrees per second"),
        (1.0, 0.2, "instead of about 9.81"),
        (0.0, 1.0, "never change"),
    ],
)
def test_wrong_units_are_told(gyro: float, accel: float, words: str) -> None:
    found = why_unusable(_scaled(gyro, accel), _IMAGES_NS)
    assert found is not None and found.is_error and words in found.reason


def test_another_clock_is_told() -> None:
    good = sensor(seconds=16.0)
    given = good.samples
    other = replace(good, samples=Samples(given.stamps_ns + 10**12, given.gyro, given.accel))
    found = why_unusable(other, _IMAGES_NS)
    assert found is not None and "covers 0 % of the images" in found.reason and found.is_error


def test_many_gaps_are_told() -> None:
    good = sensor(seconds=16.0)
    kept: Floats = np.arange(len(good.stamps_ns)) % 20 > 2
    given = good.samples
    other = Samples(given.stamps_ns[kept], given.gyro[kept], given.accel[kept])
    found = why_unusable(replace(good, samples=other), _IMAGES_NS)
    assert found is not None and "% of its samples come after a gap" in found.reason


def test_a_sensor_that_was_not_meant_for_this_is_no_error() -> None:
    found = why_unusable(replace(sensor(seconds=16.0), cam0_from_imu=None), _IMAGES_NS)
    assert found is not None and not found.is_error and "pose" in found.reason
    found = why_unusable(sensor(seconds=16.0, rate_hz=10), _IMAGES_NS)
    assert found is not None and not found.is_error and "too few" in found.reason
