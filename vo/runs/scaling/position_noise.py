"""Errors of positions: white ones, and slow ones, correlated in time as those of receivers are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats
from vo.runs.scaling.path_errors import PathErrors, Rows, log_likelihood

_STEP, _LAST_STEP = 1.2, 0.15  # of logarithms, of the search
_SMALLEST_M = 1e-3
_USUAL_FACTOR = np.log(10.0)  # standard deviation of the logarithm of the factors of odometry
_LARGEST_FACTOR = np.log(1e4)
_SLOW_S = 40.0  # usual time of slow errors of receivers, which are as large as white ones
_USUAL_SLOW = np.log([4.0, 3.0])


class Noise(NamedTuple):
    """Standard deviations along one axis.

    Attributes:
        white_m: of errors that are independent.
        slow_m: of a first-order Markov process.
        time_s: after which its correlation is 1/e.
        factors: of the variances of each kind of errors of odometry; 0 for a path without.
    """

    white_m: float
    slow_m: float
    time_s: float
    factors: tuple[float, ...]


class Measured(NamedTuple):
    """G groups of positions as rows (east, north and up of each), ways, then further rows.

    Attributes:
        rows: all of them.
        times_s: (G,).
        white: (G,) variances of white errors, relative to those of one usual position.
        axes: (3,) standard deviations of the axes, relative to the usual one.
        ways: covariance of the ways of wheels.
        further: covariance of the further rows.
    """

    rows: Rows
    times_s: Floats
    white: Floats
    axes: Floats
    ways: Floats
    further: Floats

    def covariance(self, noise: Noise, by_path: Sequence[Floats]) -> Floats:
        """(R, R) of all rows; `by_path`: for each kind of errors of the path."""
        apart = np.abs(self.times_s[:, None] - self.times_s)
        slow = noise.slow_m**2 * np.exp(-apart / noise.time_s)
        of_group = slow + np.diag(noise.white_m**2 * self.white)
        size = 3 * len(self.times_s)
        total = np.zeros_like(by_path[0])
        for factor, part in zip(noise.factors, by_path, strict=True):
            total += factor * part
        total[:size, :size] += np.kron(of_group, np.diag(self.axes**2))
        end = size + len(self.ways)
        total[size:end, size:end] += self.ways
        total[end:, end:] += self.further
        return total


def estimate_noise(
    measured: Measured,
    errors: PathErrors,
    prior: Floats,
    smallest_m: float,
    start_m: float,
    start: Noise,
    *,
    has_drift: bool,
) -> tuple[Noise, float]:
    """The most likely noise of positions and odometry, and its logarithmic likelihood.

    The factors of odometry are 1 within a factor of ten, and slow errors as large as white ones
    (`start_m`) within one of four, unless the positions say otherwise. Without drift the path is
    exact.
    """
    by_path, times_s = errors.measured(measured.rows), measured.times_s
    size = 3 * len(times_s) + len(measured.ways)
    duration = max(float(np.ptp(times_s)), 1.0) if len(times_s) else 1.0
    shortest = max(float(np.median(np.diff(times_s))), 0.1) if len(times_s) else 0.1
    low = [max(smallest_m, _SMALLEST_M), _SMALLEST_M, 0.5 * shortest]
    high = [1e3, 1e3, max(duration, shortest)]
    kinds = errors.kinds if has_drift else 0
    lowest = np.r_[np.log(low), np.full(kinds, -_LARGEST_FACTOR)]
    highest = np.r_[np.log(high), np.full(kinds, _LARGEST_FACTOR)]

    def noise_of(x: Floats) -> Noise:
        factors = np.exp(x[3:]) if has_drift else np.zeros(errors.kinds)
        white_m, slow_m, time_s = np.exp(x[:3]).tolist()
        return Noise(white_m, slow_m, time_s, tuple(factors.tolist()))

    def likelihood(x: Floats) -> float:
        far = np.r_[(x[1:3] - usual) / _USUAL_SLOW, x[3:] / _USUAL_FACTOR]
        total = measured.covariance(noise_of(x), by_path)
        # Loops agree with the path whatever its drift: they are known, and not explained.
        known = 0.5 * float(np.linalg.slogdet(total[size:, size:])[1])
        return known - 0.5 * float(far @ far) + log_likelihood(measured.rows, total, prior)

    usual = np.log([max(start_m, _SMALLEST_M), _SLOW_S])
    first = np.log([start.white_m, start.slow_m, start.time_s, *start.factors[:kinds]])
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
