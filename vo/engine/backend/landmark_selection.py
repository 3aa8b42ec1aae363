"""Choice of the landmarks of a window."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bools, Ints
from vo.engine.backend.window_problem import WindowProblem

_WORST = np.iinfo(np.int64).max  # rank before any is known


def choose_landmarks(problem: WindowProblem, max_count: int) -> Bools:
    """Mask (M,) of at most `max_count` points with two observations, one of a free pose.

    They are ranked within each keyframe by their number of observations and chosen by their best
    rank. So every keyframe keeps enough of them, even one that has just turned to a new part of the
    scene.
    """
    count = len(problem.points)
    seen = np.bincount(problem.point, minlength=count)
    moves = ~problem.fixed[problem.keyframe]
    seen_by_free = np.bincount(problem.point[moves], minlength=count)
    best = _best_ranks(problem.keyframe, problem.point, seen, len(problem.world_from_cam))
    candidates = np.flatnonzero((seen >= 2) & (seen_by_free >= 1))
    order = np.lexsort((-seen[candidates], best[candidates]))[:max_count]
    chosen = np.zeros(count, dtype=bool)
    chosen[candidates[order]] = True
    return chosen


def _best_ranks(keyframe: Ints, point: Ints, seen: Ints, keyframes: int) -> Ints:
    """(M,) best rank of each point within the keyframes that observe it; ties in order."""
    return np.asarray(_ranked(keyframe, point, seen, int(seen.max()), keyframes))


@compiled
def _ranked(keyframe, point, seen, max_seen, keyframes):  # type: ignore[no-untyped-def]
    best = np.full(len(seen), _WORST)
    rank = np.zeros((keyframes, max_seen + 1), dtype=np.int64)
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
