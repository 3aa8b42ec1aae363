"""Errors of positions: white ones, and slow ones, correlated in time as those of receivers are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vo.base.types import Floats
from vo.runs.scaling.path_graph import Noise, PathGraph

_STEP, _LAST_STEP = 1.2, 0.15  # of logarithms, of the search
_SMALLEST_M = 1e-3
_USUAL_FACTOR = np.log(10.0)  # standard deviation of the logarithm of the factors of odometry
_LARGEST_FACTOR = np.log(1e4)
_SLOW_S = 40.0  # usual time of slow errors of receivers, which are as large as white ones
_USUAL_SLOW = np.log([4.0, 3.0])


def estimate_noise(
    graph: PathGraph, smallest_m: float, start_m: float, start: Noise
) -> tuple[Noise, float]:
    """The most likely noise of positions and odometry, and its logarithmic likelihood.

    The factors of odometry are 1 within a factor of ten, and slow errors as large as white ones
    (`start_m`) within one of four, unless the positions say otherwise. Without factors in `start`
    the path is exact.
    """
    times_s = graph.times_s
    duration = max(float(np.ptp(times_s)), 1.0) if len(times_s) else 1.0
    shortest = max(float(np.median(np.diff(times_s))), 0.1) if len(times_s) else 0.1
    low = [max(smallest_m, _SMALLEST_M), _SMALLEST_M, 0.5 * shortest]
    high = [1e3, 1e3, max(duration, shortest)]
    kinds = len(start.factors)
    lowest = np.r_[np.log(low), np.full(kinds, -_LARGEST_FACTOR)]
    highest = np.r_[np.log(high), np.full(kinds, _LARGEST_FACTOR)]

    def noise_of(x: Floats) -> Noise:
        white_m, slow_m, time_s, *factors = np.exp(x).tolist()
        return Noise(white_m, slow_m, time_s, tuple(factors))

    def likelihood(x: Floats) -> float:
        far = np.r_[(x[1:3] - usual) / _USUAL_SLOW, x[3:] / _USUAL_FACTOR]
        graph.noise = noise_of(x)
        return graph.log_evidence() - 0.5 * float(far @ far)

    usual = np.log([max(start_m, _SMALLEST_M), _SLOW_S])
    first = np.log([*start[:3], *start.factors])
    if not len(times_s):  # ways show the drift of the scale alone
        lowest[:4], highest[:4] = first[:4], first[:4]
    best, value = _maximised(likelihood, np.clip(first, lowest, highest), lowest, highest)
    return noise_of(best), value


def _maximised(
    function: Callable[[Floats], float], x: Floats, lowest: Floats, highest: Floats
) -> tuple[Floats, float]:
    """Coordinate search with steps that shrink."""
    value, step = function(x), _STEP
    direction = np.ones(len(x))
    while step > _LAST_STEP:
        is_better = False
        for axis in range(len(x)):
            for _ in range(2):
                other = x.copy()
                other[axis] = np.clip(x[axis] + step * direction[axis], lowest[axis], highest[axis])
                found = function(other) if other[axis] != x[axis] else -np.inf
                if found > value + 1e-3:
                    x, value, is_better = other, found, True
                    break
                direction[axis] *= -1.0
        if not is_better:
            step *= 0.5
    return x, value
