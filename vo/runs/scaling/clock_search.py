"""The offset of a clock that was set by hand, or guessed: the one at which positions fit best."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.similarity import umeyama
from vo.base.types import Floats, Ints
from vo.runs.scaling.fit import MIN_POSITIONS, PositionFit
from vo.runs.scaling.positions import Positions

_STEP_S = 0.25
_MOST = 4000  # offsets that are tried
_COMPARED = 200  # positions
_NEAR_S = 2.0  # offsets that `fit_in_time` finds by itself
_MUCH_BETTER = 4.0  # ratio of the variances that the path doesn't explain
_EXPLAINED = 0.02
_WELL_EXPLAINED = 0.001
_OVERLAP = 0.6  # of the times that both could have in common


def search_clock(
    given: Positions, stamps_ns: Ints, xyz: Floats, plain: tuple[PositionFit, float] | None
) -> int:
    """Nanoseconds to add to the times of positions, so that they fit much better; mostly 0.

    Of all offsets at which path and positions overlap, one must explain the positions, and all
    others, that of the clocks as they are included, must be worse by far: on a straight road at
    constant speed every one explains them.

    `plain`: the fit at the times as they are, if there is one.
    """
    if len(stamps_ns) < MIN_POSITIONS or len(given.stamps_ns) < MIN_POSITIONS:
        return 0
    path_s = 1e-9 * (stamps_ns - stamps_ns[0])
    times_s = 1e-9 * (given.stamps_ns - stamps_ns[0])

    def unexplained(offset_s: float) -> float:
        return _unexplained(times_s + offset_s, given.xyz, path_s, xyz)

    now_s = 0.0 if plain is None else -plain[1]
    as_given = unexplained(now_s)
    needed_s = _OVERLAP * min(path_s[-1], times_s[-1] - times_s[0])
    first, last = needed_s - times_s[-1], path_s[-1] - needed_s - times_s[0]
    offsets = np.arange(first, last, max(_STEP_S, (last - first) / _MOST))
    if as_given < _WELL_EXPLAINED or not len(offsets):
        return 0
    left = np.array([unexplained(each) for each in offsets])
    best_s = float(offsets[left.argmin()])
    finer = best_s + np.linspace(-_STEP_S, _STEP_S, 11)
    smallest = max(min(unexplained(each) for each in finer), 1e-9)
    others = left[np.abs(offsets - best_s) > _NEAR_S].min(initial=as_given)
    is_found = smallest < _EXPLAINED and others > _MUCH_BETTER * smallest
    return round(1e9 * best_s) if is_found and abs(best_s - now_s) > _NEAR_S else 0


def _unexplained(times_s: Floats, target: Floats, path_s: Floats, xyz: Floats) -> float:
    """Fraction of the variance of positions that no similarity of the path explains."""
    inside = np.flatnonzero((times_s >= path_s[0]) & (times_s <= path_s[-1]))
    rows = inside[:: max(1, len(inside) // _COMPARED)]
    if len(rows) < MIN_POSITIONS:
        return 1.0
    source = np.column_stack([np.interp(times_s[rows], path_s, axis) for axis in xyz.T])
    try:
        moved = umeyama(source, target[rows], with_scale=True).transform_points(source)
    except ValueError:
        return 1.0
    residuals = float(((moved - target[rows]) ** 2).sum())
    return residuals / float(((target[rows] - target[rows].mean(axis=0)) ** 2).sum())
