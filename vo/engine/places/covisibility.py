"""Which stored keyframes observe the same landmarks.

Observations of a landmark form a chain, from its latest one back. Removed keyframes are skipped;
when most observations are theirs, the chains are made anew.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import compiled
from vo.base.types import Bools, Floats, Ints

_Ints32 = NDArray[np.int32]
_MAX_ID = 2**31 - 2
_FIRST_SIZE = 4096
_NONE = -1


class Shared(NamedTuple):
    """Increasing numbers (n,) of keyframes, and how many landmarks (n,) they share."""

    number: Ints
    landmarks: Ints


class Covisibility:
    """Observations of landmarks by keyframes, which are numbered as they are added."""

    def __init__(self) -> None:
        self._session: list[int] = []
        self._ids: list[_Ints32] = []
        self._kept = np.zeros(_FIRST_SIZE, np.bool_)
        self._last: dict[int, _Ints32] = {}  # by session: latest observation of each landmark
        self._visit: dict[int, _Ints32] = {}  # ... and number of the latest visit of its chain
        self._visits = 0
        self._before = np.full(_FIRST_SIZE, _NONE, np.int32)
        self._owner = np.zeros(_FIRST_SIZE, np.int32)
        self._observations = 0
        self._removed = 0

    @property
    def kept(self) -> Bools:
        """(N,) whether each keyframe is still there."""
        return self._kept[: len(self._ids)]

    def add(self, session: int, ids: Ints) -> int:
        """Add a keyframe that observes landmarks of a session; returns its number.

        Raises:
            ValueError: an id is negative or too large to be one.
        """
        if len(ids) and (ids.min() < 0 or ids.max() > _MAX_ID):
            raise ValueError(f"landmarks have ids {ids.min()} to {ids.max()}, above {_MAX_ID}")
        number = len(self._ids)
        self._session.append(session)
        self._ids.append(ids.astype(np.int32))
        self._kept = grown(self._kept, number + 1, False)
        self._kept[number] = True
        self._append(number)
        return number

    def remove(self, number: int) -> None:
        """Forget a keyframe."""
        self._kept[number] = False
        self._removed += len(self._ids[number])
        self._ids[number] = np.zeros(0, np.int32)
        if 2 * self._removed > self._observations:
            self._rebuild()

    def shared(self, number: int) -> Shared:
        """The other keyframes with a common landmark."""
        counts = np.zeros(len(self._ids), np.int32)
        last = self._last[self._session[number]]
        _count_shared(self._ids[number], last, self._before, self._owner, self._kept, counts)
        counts[number] = 0
        numbers = np.flatnonzero(counts)
        return Shared(numbers, counts[numbers].astype(np.int64))

    def shared_with_any(self, numbers: Ints) -> Ints:
        """Keyframes with a landmark of one of several of one session, these included."""
        found = np.zeros(len(self._ids), np.bool_)
        if len(numbers):
            session, self._visits = self._session[numbers[0]], (self._visits + 1) % _MAX_ID
            ids = np.concatenate([self._ids[number] for number in numbers.tolist()])
            chains = self._last[session], self._before, self._owner, self._kept
            _mark_shared(ids, *chains, self._visit[session], self._visits, found)
        return np.flatnonzero(found)

    def seen_ratios(self, numbers: Ints, observers: int) -> Floats:
        """(n,) ratio of landmarks of n keyframes of a session that so many others observe."""
        if not len(numbers):
            return np.empty(0)
        ids = [self._ids[number] for number in numbers.tolist()]
        last = self._last[self._session[numbers[0]]]
        chains = last, self._before, self._owner, self._kept
        is_seen = _is_seen(np.concatenate(ids), *chains, observers + 1)  # one is the keyframe
        size = np.array([len(each) for each in ids])
        ratios: Floats = np.add.reduceat(is_seen, np.cumsum(size) - size, dtype=np.int64) / size
        return ratios

    def _append(self, number: int) -> None:
        ids, session = self._ids[number], self._session[number]
        end = self._observations + len(ids)
        size = int(ids[-1]) + 1 if len(ids) else 0
        for chains in (self._last, self._visit):
            first = chains.get(session, np.full(_FIRST_SIZE, _NONE, np.int32))
            chains[session] = grown(first, size, _NONE)
        self._before = grown(self._before, end, _NONE)
        self._owner = grown(self._owner, end, 0)
        rows = slice(self._observations, end)
        self._before[rows] = self._last[session][ids]
        self._last[session][ids] = np.arange(self._observations, end, dtype=np.int32)
        self._owner[rows] = number
        self._observations = end

    def _rebuild(self) -> None:
        for last in self._last.values():
            last[:] = _NONE
        self._observations = self._removed = 0
        for number in np.flatnonzero(self.kept).tolist():
            self._append(number)


def grown(array: NDArray[Any], size: int, fill: float) -> NDArray[Any]:
    """The array, or a copy that is at least twice as long if it has fewer than `size` elements."""
    if size <= len(array):
        return array
    more = np.full(max(size, 2 * len(array)) - len(array), fill, array.dtype)
    return np.concatenate([array, more])


@compiled
def _count_shared(ids, last, before, owner, kept, counts):  # type: ignore[no-untyped-def]
    """Count the landmarks that each keyframe shares."""
    for n in range(len(ids)):
        at = last[ids[n]]
        while at >= 0:
            if kept[owner[at]]:
                counts[owner[at]] += 1
            at = before[at]


@compiled
def _mark_shared(ids, last, before, owner, kept, visit, number, found):  # type: ignore[no-untyped-def]
    """Mark the keyframes that observe one of some landmarks; each chain is visited once."""
    for n in range(len(ids)):
        if visit[ids[n]] == number:
            continue
        visit[ids[n]] = number
        at = last[ids[n]]
        while at >= 0:
            if kept[owner[at]]:
                found[owner[at]] = True
            at = before[at]


@compiled
def _is_seen(ids, last, before, owner, kept, least):  # type: ignore[no-untyped-def]
    """(n,) whether landmarks have so many kept observations at least."""
    result = np.zeros(len(ids), dtype=np.bool_)
    for n in range(len(ids)):
        count, at = 0, last[ids[n]]
        while at >= 0 and count < least:
            if kept[owner[at]]:
                count += 1
            at = before[at]
        result[n] = count >= least
    return result
