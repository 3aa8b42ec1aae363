"""Matches that move alike: each tells a turn, a scale and a place, as its two features do.

Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004, sec. 7.3,
without bins.
"""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Bools, Floats, Floats32, Ints

_SHEAR = 0.4  # difference of two motions per distance: views from the side still agree
_LOOSE_PX = 6.0
_MAX_TURN = float(np.deg2rad(35.0))
_MAX_ZOOM = float(np.log(2.0))


def moves(stored: tuple[Floats32, ...], scene: tuple[Floats32, ...]) -> Floats:
    """(n, 8) motions of matches, for `best_agreement` and `largest_agreements`.

    `stored`: pixels (n, 2), angles (n,) in radians and sizes (n,) of the stored features.
    """
    turn = (scene[1] - stored[1]).astype(np.float64)
    zoom = np.log(scene[2].astype(np.float64) / stored[2])
    factor = np.exp(zoom)
    motion = [factor * np.cos(turn), factor * np.sin(turn), zoom, turn]
    return np.column_stack([stored[0], scene[0], *motion])


def best_agreement(motion: Floats, place: Ints) -> Bools:
    """(n,) which matches agree with the one that agrees with most places.

    `motion`: (n, 8) of `moves`, at least one. `place`: (n,) numbers from 0; matches of one place
    count once.
    """
    best = _most_supported(motion, place.astype(np.int64), int(place.max()) + 1)
    return np.asarray(_supporters(motion, best))


@compiled
def largest_agreements(motion, weight, begin, tried):  # type: ignore[no-untyped-def]
    """(groups,) largest sum of weights of matches that agree with one of their group.

    `motion`: (n, 8) of `moves`, sorted by group. `weight`: (n,) of the matches. `begin`: (groups +
    1,) first row of each group.
    """
    largest = np.zeros(len(begin) - 1, dtype=np.float64)
    for group in range(len(begin) - 1):
        first, last = begin[group], begin[group + 1]
        heaviest = first + np.argsort(-weight[first:last], kind="mergesort")[:tried]
        for i in heaviest:
            total = 0.0
            for j in range(first, last):
                if _agree(motion, i, j):
                    total += weight[j]
            largest[group] = max(largest[group], total)
    return largest


@compiled
def _most_supported(motion, place, places):  # type: ignore[no-untyped-def]
    """Row of the match that agrees with most places, the first of several."""
    counted = np.full(places, -1, dtype=np.int64)  # the match that a place was counted for last
    best, most = 0, 0
    for i in range(len(motion)):
        count = 0
        for j in range(len(motion)):
            if counted[place[j]] != i and _agree(motion, i, j):
                counted[place[j]] = i
                count += 1
        if count > most:
            best, most = i, count
    return best


@compiled
def _supporters(motion, i):  # type: ignore[no-untyped-def]
    """(n,) matches that agree with one."""
    result = np.zeros(len(motion), dtype=np.bool_)
    for j in range(len(motion)):
        result[j] = _agree(motion, i, j)
    return result


@compiled(**NO_REFCOUNT)
def _agree(motion, i, j):  # type: ignore[no-untyped-def]
    """Whether the motion of match i predicts match j, roughly."""
    if abs(motion[j, 6] - motion[i, 6]) > _MAX_ZOOM:
        return False
    turn = motion[j, 7] - motion[i, 7]
    if abs(turn - 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))) > _MAX_TURN:
        return False
    x, y = motion[j, 0] - motion[i, 0], motion[j, 1] - motion[i, 1]
    away_x = motion[i, 2] + motion[i, 4] * x - motion[i, 5] * y - motion[j, 2]
    away_y = motion[i, 3] + motion[i, 5] * x + motion[i, 4] * y - motion[j, 3]
    size = np.sqrt(motion[i, 4] * motion[i, 4] + motion[i, 5] * motion[i, 5])
    reach = _SHEAR * size * np.sqrt(x * x + y * y) + _LOOSE_PX
    return bool(away_x * away_x + away_y * away_y <= reach * reach)
