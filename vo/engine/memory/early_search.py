"""Search for the places of keyframes before they are removed from the local map."""

from __future__ import annotations

from concurrent.futures import Future

from vo.engine.mapping.local_map import LocalMap
from vo.engine.memory.place_maker import PlaceMaker
from vo.engine.memory.recognition import SUCCESSION, Recognised, Recogniser

# Frames from a search to the use of its result; the number is fixed, so that the path does not
# depend on the speed of the search. At most one keyframe is searched in so many frames.
_LATENCY = 3


class EarlySearch:
    """Searches for the newest keyframe of a segment that nothing connects with older ones yet.

    Such a segment begins with a map of its own, after tracking was lost or at the start of a run
    in a loaded map. Its keyframes would otherwise be searched ten keyframes later, when they are
    stored. The evidence for a loop is the same.
    """

    def __init__(self, maker: PlaceMaker, recogniser: Recogniser) -> None:
        self._maker = maker
        self._recogniser = recogniser
        self._future: Future[Recognised] | None = None
        self._due = 0  # number of the frame at which the result is used
        self._newest = -1  # id of the newest keyframe that was searched

    def submit(self, frame: int, local_map: LocalMap) -> None:
        """Search for the newest keyframe, unless it was searched or another search is going on."""
        keyframes = local_map.of_first_view
        if self._future is not None or not keyframes or keyframes[-1].id <= self._newest:
            return
        self._newest = keyframes[-1].id
        if len(keyframes) >= SUCCESSION:
            places = self._maker.newest(local_map, SUCCESSION)
            self._future, self._due = self._recogniser.search(places), frame + _LATENCY

    def result(self, frame: int | None = None) -> Recognised | None:
        """Wait for the result, if there is one and it is due; None for `frame` is any time."""
        if self._future is None or (frame is not None and frame < self._due):
            return None
        future, self._future = self._future, None
        return future.result()
