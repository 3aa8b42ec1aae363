"""Smoothing of series, and random series that are smooth."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats


def smoothed_closed(values: Floats, width: float) -> Floats:
    """Smooth a closed series (M, C): three running means over a third of `width` rows each."""
    box = max(1, round(width / 3.0)) | 1
    for _ in range(3):
        values = _averaged(values, box, "wrap")
    return values


def smoothed(values: Floats, width: float) -> Floats:
    """Smooth an open series (N,) in the same way; its end values are repeated."""
    box = max(1, round(width / 3.0)) | 1
    for _ in range(3):
        values = _averaged(values[:, None], box, "edge")[:, 0]
    return values


def wander(
    rng: np.random.Generator,
    times_s: Floats,
    amplitude: float,
    periods_s: tuple[float, float],
    repeat_s: float | None = None,
) -> Floats:
    """A smooth random series (N,) within ±amplitude, of three waves.

    `rng`: random numbers. `times_s`: (N,). `amplitude`: largest value. `repeat_s`: its period, or
    None for an aperiodic series.
    """
    total = np.zeros(len(times_s))
    for _ in range(3):
        frequency = float(rng.uniform(1.0 / periods_s[1], 1.0 / periods_s[0]))
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        if repeat_s is not None:
            frequency = max(1, round(frequency * repeat_s)) / repeat_s
        total += np.sin(2.0 * np.pi * frequency * times_s + phase)
    return np.asarray(amplitude / 3.0 * total)


def _averaged(values: Floats, box: int, mode: str) -> Floats:
    """Running mean of (M, C) over an odd number of rows, relative to the mean for precision."""
    if box <= 1:
        return values
    middle = values.mean(axis=0)
    reach = box // 2
    index = np.arange(-reach - 1, len(values) + reach)
    index = index % len(values) if mode == "wrap" else np.clip(index, 0, len(values) - 1)
    sums = np.cumsum(values[index] - middle, axis=0)
    return np.asarray(middle + (sums[box:] - sums[:-box]) / box)
