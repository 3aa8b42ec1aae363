"""Medians and percentiles of few numbers; numpy's import a package of their own, 10 ms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


def median(values: ArrayLike) -> float:
    """Of one number or more, in any shape; NaN counts as the highest."""
    ranked = np.sort(values, axis=None)
    last = len(ranked) - 1
    return 0.5 * (float(ranked[last // 2]) + float(ranked[(last + 1) // 2]))


def percentiles(values: ArrayLike, percents: Sequence[float]) -> list[float]:
    """Of one number or more, in any shape; in between two numbers it is interpolated."""
    ranked = np.sort(values, axis=None)
    last = len(ranked) - 1
    at = [0.01 * percent * last for percent in percents]
    found: list[float] = np.interp(at, np.arange(last + 1), ranked).tolist()
    return found
