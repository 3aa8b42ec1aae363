"""Faults of an inertial sensor, as changes of the samples of a good one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from inertial_flight import START_NS, Samples, Sensor, path

from vo.base.types import Floats, Ints

Change = Callable[[Floats, Floats], Floats]
"""Changes values (n, 6), rates before forces, at times (n,) s."""


def changed(source: Sensor, change: Change) -> Sensor:
    """The sensor with changed values."""
    given = source.samples
    values = np.concatenate([given.gyro, given.accel], axis=1)
    values = change(1e-9 * (given.stamps_ns - START_NS), values)
    return replace(source, samples=Samples(given.stamps_ns, values[:, :3], values[:, 3:]))


def restamped(source: Sensor, stamps_ns: Ints) -> Sensor:
    """The sensor with other times."""
    return replace(source, samples=replace(source.samples, stamps_ns=stamps_ns))


def added(values: list[float], begin_s: float, end_s: float) -> Change:
    """Six values are added to those of a time."""

    def change(seconds: Floats, samples: Floats) -> Floats:
        inside = (seconds > begin_s) & (seconds < end_s)
        return samples + np.where(inside[:, None], values, 0.0)

    return change


def shaken(size: float, begin_s: float, end_s: float) -> Change:
    """Random forces and rates, as at a hard landing."""

    def change(seconds: Floats, samples: Floats) -> Floats:
        inside = (seconds > begin_s) & (seconds < end_s)
        noise = np.random.default_rng(5).standard_normal(samples.shape)
        noise[:, :3] *= 0.1
        return samples + size * noise * inside[:, None]

    return change


def frozen(begin_s: float, end_s: float) -> Change:
    """Values stand still."""

    def change(seconds: Floats, samples: Floats) -> Floats:
        inside = (seconds > begin_s) & (seconds < end_s)
        return np.where(inside[:, None], samples[inside.argmax()], samples)

    return change


def in_vehicle(accelerations: list[float], begin_s: float, end_s: float) -> Change:
    """Sensor and all that images show are in a vehicle that accelerates (3,), softly."""

    def change(seconds: Floats, samples: Floats) -> Floats:
        ramp = np.minimum((seconds - begin_s) / 0.5, (end_s - seconds) / 0.5).clip(0.0, 1.0)
        force = np.einsum("nji,nj->ni", path(seconds)[0], np.outer(ramp, accelerations))
        return samples + np.concatenate([np.zeros_like(force), force], axis=1)

    return change


def scaled(gyro: float, accel: float) -> Change:
    """Rates and forces are too large by these factors."""
    return lambda _, samples: samples * np.repeat([gyro, accel], 3)
