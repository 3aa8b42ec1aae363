"""The variance of a scale by positions whose errors are correlated in time.

Errors are the sum of a first-order Markov process, whose correlation after a time t is exp(-|t|/T),
and of white noise, whose share of the variance is w. T and w are unknown, and the residuals of a
fit are less correlated than the errors, as the fit removes what changes slowly. So each pair (T, w)
is weighted by its restricted likelihood (Patterson and Thompson 1971), that of what the parameters
cannot explain, and the variances are averaged with these weights. Before, all T are equally likely
on a logarithmic scale, up to three times the duration: whether errors change more slowly than the
path is long, it cannot show.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from vo.base.types import Floats, Ints

_TIMES = 9
_LONGEST = 3.0  # times the duration
_SHORTEST = 0.25  # times the interval: white errors
_SHARES = (0.0, 0.2, 0.6)
_MOST = 80  # positions; more are averaged in groups


def correlated_variance(
    times_s: Floats, influence: Floats, design: Sequence[Floats], residuals: Floats
) -> tuple[float, float]:
    """Variance of a number that is a weighted sum of errors.

    Args:
        times_s: (N,) increasing.
        influence: (N, 3) derivative of the number by the errors.
        design: P columns (N, 3): derivatives of the positions by the parameters.
        residuals: (N, 3) of the fit.

    Returns:
        The variance, and its ratio to that by white errors, at least 1.
    """
    group = np.arange(len(times_s)) // -(-len(times_s) // _MOST)
    sizes = np.bincount(group)
    means = _sums(group, np.stack([*design, residuals], axis=2)) / sizes[:, None, None]
    times = _sums(group, times_s) / sizes
    weights = _sums(group, influence)
    count, width = len(times), means.shape[2]
    free = max(3 * count - len(design), 1)
    logs, variances = [], []
    for values, vectors in zip(*_modes(times.tobytes()), strict=True):
        turned = (vectors.T @ means.reshape(count, -1)).reshape(count, 3, width)
        squares = ((vectors.T @ weights) ** 2).sum(axis=1)
        for share in _SHARES:
            spread = (1.0 - share) * np.maximum(values, 1e-9) + share
            white = (turned / np.sqrt(spread)[:, None, None]).reshape(3 * count, width)
            q, upper = np.linalg.qr(white[:, :-1])
            left = white[:, -1] - q @ (q.T @ white[:, -1])
            variance = max(float(left @ left), 1e-300) / free
            diagonal = np.maximum(np.abs(np.diag(upper)), 1e-300)
            determinant = 3.0 * np.log(spread).sum() + 2.0 * np.log(diagonal).sum()
            logs.append(-0.5 * (free * np.log(variance) + determinant))
            variances.append(variance * float(spread @ squares))
    likely = np.exp(np.array(logs) - max(logs))
    mean = float(likely @ variances / likely.sum())
    return mean, max(mean / variances[0], 1.0)


@lru_cache(maxsize=4)
def _modes(times_s: bytes) -> tuple[Floats, Floats]:
    """Eigenvalues (T, N) and vectors (T, N, N) of the correlations of each time; of many fits."""
    times = np.frombuffer(times_s)
    shortest = _SHORTEST * float(np.median(np.diff(times)))
    longest = max(_LONGEST * float(times[-1] - times[0]), 2.0 * shortest)
    scales = np.geomspace(shortest, longest, _TIMES)[:, None, None]
    values, vectors = np.linalg.eigh(np.exp(-np.abs(times[:, None] - times) / scales))
    return values, vectors


def _sums(group: Ints, values: Floats) -> Floats:
    """Sums of rows by the number of their group."""
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    return np.asarray(np.add.reduceat(values, starts, axis=0), np.float64)
