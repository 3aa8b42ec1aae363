"""Samples that cannot be measurements are refused, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from inertial_flight import NOISE, START_NS, Sensor, sensor
from sensor_faults import Change, added, changed, frozen, shaken

from vo.base.types import Bools, Floats
from vo.engine.inertial.preintegration import preintegrate
from vo.engine.inertial.sample_checks import refused_samples
from vo.engine.inertial.samples import SampleReader

_GLITCH = [30.0, -30.0, 30.0, 150.0, -150.0, 150.0]
_KNOCK = [0.0, 0.0, 0.0, 60.0, 0.0, 0.0]


def _good() -> Sensor:
    return sensor(noise=1.0, seconds=10.0)


def _refused(source: Sensor) -> Bools:
    samples = source.samples
    values = np.concatenate([samples.gyro, samples.accel], axis=1)
    found = refused_samples(samples.stamps_ns, values)
    return np.zeros(len(values), bool) if found is None else found


@pytest.mark.parametrize(
    ("change", "begin_s", "end_s"),
    [
        (added(_GLITCH, 4.999, 5.001), 5.0, 5.0),
        (added([0.2 * v for v in _GLITCH], 4.999, 5.001), 5.0, 5.0),
        (added(_KNOCK, 5.0, 5.04), 5.005, 5.035),
        (added([0.25 * v for v in _KNOCK], 7.0, 7.02), 7.005, 7.015),
        (shaken(30.0, 3.0, 3.3), 3.02, 3.28),
        (frozen(6.0, 6.2), 6.01, 6.19),
        (frozen(2.0, 3.0), 2.01, 2.99),
    ],
)
def test_samples_of_a_fault_are_refused_and_no_others(
    change: Change, begin_s: float, end_s: float
) -> None:
    source = changed(_good(), change)
    seconds = 1e-9 * (source.stamps_ns - START_NS)
    refused = _refused(source)
    inside = (seconds > begin_s - 1e-6) & (seconds < end_s + 1e-6)
    assert refused[inside].all()
    assert not refused[(seconds < begin_s - 0.05) | (seconds > end_s + 0.05)].any()


def test_the_end_of_the_range_is_refused() -> None:
    def shaken_hard(seconds: Floats, values: Floats) -> Floats:
        forces = np.outer(np.sin(6.0 * seconds), [0.0, 0.0, 0.0, 0.0, 0.0, 12.0])
        return np.clip(values + forces, -16.0, 16.0)

    source = changed(_good(), shaken_hard)
    clipped = source.samples.accel[:, 2] == 16.0
    assert clipped.sum() > 100
    held = clipped[1:-1] & clipped[:-2] & clipped[2:]
    refused = _refused(source)
    assert refused[1:-1][held].all() and not refused[~clipped].any()


def _stepped(_: Floats, values: Floats) -> Floats:
    """Of low resolution."""
    return np.round(values / [0.01, 0.01, 0.01, 0.1, 0.1, 0.1]) * [0.01, 0.01, 0.01, 0.1, 0.1, 0.1]


@pytest.mark.parametrize(
    "change",
    [
        lambda _, v: v,
        _stepped,
        lambda _, v: np.repeat(v[::2], 2, axis=0),  # each sample twice
        lambda _, v: 0.0 * v + v[0],  # at rest, and simulated without noise
        lambda s, v: v + np.outer(np.sin(60.0 * s), [0.5, 0.5, 0.5, 12.0, 12.0, 12.0]),  # vibrates
        lambda s, v: v + np.outer(np.sin(8.0 * s), [5.0, 5.0, 5.0, 20.0, 20.0, 20.0]),  # shaken
    ],
)
def test_nothing_is_refused_of_a_good_sensor(change: Change) -> None:
    assert not _refused(changed(_good(), change)).any()


@pytest.mark.parametrize("rate_hz", [50, 100, 400, 1000])
def test_rates_make_no_difference(rate_hz: int) -> None:
    good = sensor(noise=1.0, seconds=10.0, rate_hz=rate_hz)
    assert not _refused(good).any()
    wrong = _refused(changed(good, added(_GLITCH, 5.0 - 0.5 / rate_hz, 5.0 + 0.5 / rate_hz)))
    assert wrong[5 * rate_hz] and wrong.sum() <= 5


def test_short_faults_are_bridged_with_larger_noise() -> None:
    reader = SampleReader(changed(_good(), added(_GLITCH, 4.999, 5.001)))
    found = reader.between(START_NS + 4_800_000_000, START_NS + 5_200_000_000)
    good = SampleReader(_good()).between(START_NS + 4_800_000_000, START_NS + 5_200_000_000)
    assert found is not None and good is not None
    assert good.bridged_s == 0.0 and 0.02 < found.bridged_s < 0.04
    zero = np.zeros(3)
    moved, right = (preintegrate(each, zero, zero, NOISE) for each in (found, good))
    off = np.abs(moved.velocity - right.velocity)
    assert (off < 3.0 * np.sqrt(np.diag(moved.covariance)[3:6])).all()
    assert np.diag(moved.covariance)[3] > 10.0 * np.diag(right.covariance)[3]


def test_long_faults_give_nothing() -> None:
    reader = SampleReader(changed(_good(), shaken(30.0, 3.0, 3.3)))
    assert reader.between(START_NS + 2_900_000_000, START_NS + 3_400_000_000) is None
    assert reader.between(START_NS + 3_500_000_000, START_NS + 3_900_000_000) is not None
