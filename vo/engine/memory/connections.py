"""Which segments and worlds loops connect."""

from __future__ import annotations

from vo.engine.mapping.keyframe import FrameId
from vo.engine.memory.map_worlds import WorldsInMap
from vo.engine.memory.reports import LoopEnds
from vo.engine.places.records import Loop, PlaceKey
from vo.engine.trajectory.store import TrajectoryStore


class Connections:
    """Tells which segments and worlds are connected by loops.

    Attributes:
        frames: of keyframes in the graph.

    Args:
        store: of the path, which knows the world of each segment.
        worlds: those of a loaded map.
    """

    def __init__(self, store: TrajectoryStore, worlds: WorldsInMap) -> None:
        self.frames: dict[PlaceKey, FrameId] = {}
        self._store = store
        self._worlds = worlds

    def ends(self, loop: Loop) -> LoopEnds:
        """The frames of both keyframes of a loop."""
        known = self._worlds.frame(loop.earlier)
        session = None if known is None else loop.earlier.session
        return LoopEnds(self.frames[loop.later], known or self.frames[loop.earlier], session)

    def is_apart(self, segment: int) -> bool:
        """Whether nothing connects a segment with an older world."""
        return self._worlds.has_older(segment, self._store.world(segment))

    def is_joining(self, loop: Loop, segment: int) -> bool:
        """Whether a loop is from a segment to another one."""
        if self.frames[loop.later].segment != segment:
            return False
        is_loaded = self._worlds.frame(loop.earlier) is not None
        return is_loaded or self.frames[loop.earlier].segment != segment

    def is_joined_by(self, loop: Loop) -> bool:
        """Whether a loop connects worlds that were not connected before."""
        if self._worlds.frame(loop.earlier) is not None:
            return self._store.world(self.frames[loop.later].segment) not in self._worlds.met
        worlds = {self._store.world(self.frames[k].segment) for k in (loop.earlier, loop.later)}
        return len(worlds) > 1
