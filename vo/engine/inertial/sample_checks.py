"""Samples that cannot be measurements, found before anything is computed with them.

Refused are spikes (bit errors, knocks on the housing), values at the end of the sensor's range, and
values that stand still while the sensor moves. Whoever reads the rest sees a gap.
"""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools, Floats, Ints

_GYRO, _ACCEL = slice(0, 3), slice(3, 6)
_COLUMNS = np.repeat([0, 1], 3)
# Distance from the running median, rad/s and m/s²: at least, and in spreads of the values nearby.
_MIN_SPIKE = np.array([1.0, 8.0])[_COLUMNS]
_SPREADS = 8.0
_WINDOW_S = 0.1  # of the running median: spikes of up to half of it are found
_BESIDE = 2  # samples on both sides of a spike that are refused with it
_MIN_RANGE = np.array([2.0, 15.0])[_COLUMNS]  # smallest ends of a range: 125 degrees/s and 2 g
_MIN_HELD = 3  # consecutive samples with the same values
_MAX_AT_END = 0.5  # of the samples; more are not clipped, but constant
_MIN_FROZEN_S = 0.02
_FROZEN_JUMP = 10.0  # after frozen values, in usual changes from sample to sample


def refused_samples(stamps_ns: Ints, values: Floats) -> Bools | None:
    """Which samples to refuse; None if there are none, as nearly always.

    `values`: (n, 6) rates in rad/s and forces in m/s².
    """
    if len(values) < 2 * _MIN_HELD:
        return None
    change = np.abs(np.diff(values, axis=0))
    found = _spikes(stamps_ns, values, change) | _clipped(values)
    found |= _frozen(stamps_ns, change)
    return found if found.any() else None


def _spikes(stamps_ns: Ints, values: Floats, change: Floats) -> Bools:
    """Samples far from the running median; only those beside a sudden change are compared."""
    result = np.zeros(len(values), bool)
    jumps = np.flatnonzero((change > 0.5 * _MIN_SPIKE).any(axis=1))
    if not len(jumps):
        return result
    spread = np.median(np.abs(values - np.median(values, axis=0)), axis=0)
    limit = np.maximum(_MIN_SPIKE, _SPREADS * spread)
    step_s = 1e-9 * float(np.median(np.diff(stamps_ns)))
    half = max(2, round(0.5 * _WINDOW_S / step_s))
    around = np.arange(-half, half + 1)
    rows = np.unique((jumps[:, None] + around).clip(0, len(values) - 1))
    near = (rows[:, None] + around).clip(0, len(values) - 1)
    off = np.abs(values[rows] - np.median(values[near], axis=1))
    spikes = rows[(off > limit).any(axis=1)]
    beside = np.arange(-_BESIDE, _BESIDE + 1)
    result[(spikes[:, None] + beside).clip(0, len(values) - 1)] = True
    return result


def _clipped(values: Floats) -> Bools:
    """Samples that stay at the largest or smallest value of an axis, as at the end of its range."""
    result = np.zeros(len(values), bool)
    for sign in (1.0, -1.0):
        highest = (sign * values).max(axis=0)
        for axis in np.flatnonzero(highest >= _MIN_RANGE).tolist():
            at_end = sign * values[:, axis] == highest[axis]
            if _MIN_HELD <= at_end.sum() < _MAX_AT_END * len(values):
                result |= _runs(at_end, _MIN_HELD)
    return result


def _frozen(stamps_ns: Ints, change: Floats) -> Bools:
    """Samples that repeat all six values until these jump; a sensor at rest does not jump."""
    result = np.zeros(len(stamps_ns), bool)
    same = ~change.any(axis=1)
    if same.sum() < _MIN_HELD:
        return result
    # Of values that change at all: steps of a low resolution are no jumps.
    usual = [np.median(axis[axis > 0.0]) if axis.any() else np.inf for axis in change.T]
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(np.int8)))
    for begin, end in edges.reshape(-1, 2).tolist():
        if end >= len(change) or stamps_ns[end] - stamps_ns[begin] < _MIN_FROZEN_S * 1e9:
            continue
        if (change[end] > _FROZEN_JUMP * np.array(usual)).any():
            result[begin : end + 1] = True
    return result


def _runs(held: Bools, least: int) -> Bools:
    """Where a condition holds in at least so many consecutive samples."""
    result = np.zeros(len(held), bool)
    edges = np.flatnonzero(np.diff(np.r_[False, held, False].astype(np.int8)))
    for begin, end in edges.reshape(-1, 2).tolist():
        if end - begin >= least:
            result[begin:end] = True
    return result
