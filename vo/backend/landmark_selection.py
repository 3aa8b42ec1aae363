"""Which landmarks take part in a window."""

from __future__ import annotations

import numpy as np

from vo.compiling.function import compiled
from vo.types import Bools, Ints, WindowProblem


def choose_landmarks(problem: WindowProblem, most: int) -> Bools:
    """Mask (M,) of at most so many points that are seen twice, also by a pose that may move.

    They are ranked within each keyframe, most seen first, and taken by their best rank. That gives
    every keyframe its share, also one that has just turned to a part of the scene that no other
    keyframe has seen for long.
    """
    count = len(problem.points)
    seen = np.bincount(problem.point, minlength=count)
    moves = ~problem.fixed[problem.keyframe]
    seen_by_free = np.bincount(problem.point[moves], minlength=count)
    best = _best_ranks(problem.keyframe, problem.point, seen, len(problem.world_from_cam))
    candidates = np.flatnonzero((seen >= 2) & (seen_by_free >= 1))
    order = np.lexsort((-seen[candidates], best[candidates]))[:most]
    chosen = np.zeros(count, dtype=bool)
    chosen[candidates[order]] = True
    return chosen


def _best_ranks(keyframe: Ints, point: Ints, seen: Ints, keyframes: int) -> Ints:
    """(M,) least number of points that a keyframe has before this one; of equal ones in order."""
    return np.asarray(_ranked(keyframe, point, seen, keyframes))


@compiled
def _ranked(keyframe, point, seen, keyframes):  # type: ignore[no-untyped-def]
    best = np.full(len(seen), np.iinfo(np.int64).max)
    rank = np.zeros((keyframes, seen.max() + 1), dtype=np.int64)
    for n in range(len(point)):
        rank[keyframe[n], seen[point[n]]] += 1
    for k in range(keyframes):  # from how many there are to where they begin
        before = 0
        for times in range(rank.shape[1] - 1, -1, -1):
            count = rank[k, times]
            rank[k, times] = before
            before += count
    for n in range(len(point)):
        k, m = keyframe[n], point[n]
        best[m] = min(best[m], rank[k, seen[m]])
        rank[k, seen[m]] += 1
    return best
