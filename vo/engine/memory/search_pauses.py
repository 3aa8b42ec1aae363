"""Which keyframes of places that are known well are searched, and which are stored.

A camera that stays in one room would find loops, and store keyframes of the same views, without
end. So the more loops have led to a place, the seldomer it is searched, and of a place that many
have led to, keyframes that look like stored ones are not kept. Each failed search there delays that
only: of a few in a row none is a sign of another place.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Loop, Place, PlaceKey

_MIN_SHARED = 15  # landmarks of keyframes of the same place
# After so many keyframes in a row with loops, only one is searched in so much time; where more than
# so many loops were found the time grows with the square of their number, to the longest.
_STEADY, _PAUSE_NS, _LONGEST_NS = 3, 500_000_000, 2_000_000_000
_FEW_LOOPS = 40
_MANY_LOOPS = 80  # at places of which no more keyframes are needed


class SearchPauses:
    """Chooses the keyframes that are searched, and those that are not kept."""

    def __init__(self, database: KeyframeDatabase) -> None:
        self._database = database
        # Loops of all visits are counted at keyframes of the first one.
        self._first_of: dict[PlaceKey, PlaceKey] = {}  # by keyframe with a loop
        self._loops_at: Counter[PlaceKey] = Counter()
        self._in_a_row = self._failed = 0  # keyframes with loops, without them where many led
        self._last_ns = 0  # time of the last one of them
        self._loops_here = 0  # at its place
        self._spare: list[PlaceKey] = []  # not searched since, at places with many loops

    def begin_segment(self) -> None:
        """Search all keyframes until loops are found."""
        self._in_a_row = self._failed = 0
        for key in self._spare:
            del self._first_of[key]
        self._spare.clear()

    def skips(self, place: Place) -> bool:
        """Whether a stored keyframe is not searched."""
        since_ns = place.frame.stamp_ns - self._last_ns
        factor = 1.0 if self._failed else max(1.0, self._loops_here / _FEW_LOOPS) ** 2
        if self._in_a_row < _STEADY or since_ns >= min(factor * _PAUSE_NS, _LONGEST_NS):
            return False
        if self._loops_here < _MANY_LOOPS:
            return True
        return self._is_spare(place) or since_ns < _PAUSE_NS

    def note(self, place: Place, loops: Sequence[Loop]) -> tuple[PlaceKey, ...]:
        """Note the loops of a keyframe, the best first; removes and returns needless keyframes."""
        self._last_ns = place.frame.stamp_ns
        if not loops:
            self._failed += 1
            if self._failed == _STEADY or not self._is_spare(place):
                self.begin_segment()
            return ()
        self._in_a_row, self._failed = self._in_a_row + 1, 0
        first = self._first(loops[0].earlier)
        self._first_of[loops[0].earlier] = self._first_of[place.key] = first
        self._loops_at[first] += 1
        self._loops_here = self._loops_near(first)
        spare, self._spare = [*self._spare, place.key], []
        if self._loops_here < _MANY_LOOPS:
            return ()
        removed = tuple(key for key in spare if key in self._database)
        for key in removed:
            self._database.remove(key)
            del self._first_of[key]
        return removed

    def _is_spare(self, place: Place) -> bool:
        """Note a keyframe that resembles most a place with many loops, if it does."""
        candidates = self._database.query(place) if self._loops_at.total() >= _MANY_LOOPS else []
        first = self._first(candidates[0].key) if candidates else None
        if first is None or self._loops_near(first) < _MANY_LOOPS:
            return False
        self._first_of[place.key] = first  # those that resemble this one are at the same place
        self._spare.append(place.key)
        return True

    def _near(self, key: PlaceKey) -> list[PlaceKey]:
        """A keyframe and those that share landmarks with it, most first."""
        if key not in self._database:  # frames were tracked anew
            return [key]
        return [key, *(other for other, _ in self._database.covisible(key, _MIN_SHARED))]

    def _first(self, key: PlaceKey) -> PlaceKey:
        """The keyframe of the first visit at which loops to a keyframe are counted."""
        return next((self._first_of[k] for k in self._near(key) if k in self._first_of), key)

    def _loops_near(self, first: PlaceKey) -> int:
        return sum(self._loops_at[key] for key in self._near(first))
