"""Where a run is in the map that was loaded."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vo.base.records.closed_loops import MapUse
from vo.engine.mapping.keyframe import FrameId
from vo.engine.places.records import MarkerVisit, PlaceKey, RegisteredKeyframes
from vo.engine.trajectory.metric_segments import MetricSegments

if TYPE_CHECKING:
    from vo.engine.maps.loading import LoadedMap


class RunInMap:
    """Which worlds of the run are in the loaded map, and the frames of its keyframes.

    The pose graph numbers the worlds of the map first. For the run a world has the number of the
    first of its own segments, as without a map.

    Attributes:
        met: numbers of the worlds of the run that are in the map.
    """

    def __init__(self, file: str, loaded: LoadedMap | None, metric: MetricSegments) -> None:
        self.met: tuple[int, ...] = ()
        self._file = file
        self._loaded = loaded
        self._metric = metric

    @property
    def use(self) -> MapUse | None:
        """What is reported, None without a map."""
        if self._loaded is None:
            return None
        return MapUse(self._file, self._loaded.header.sessions, self.met, self._metric.by_map)

    @property
    def markers(self) -> list[tuple[MarkerVisit, FrameId]]:
        """Markers of the map, and the frames of the keyframes that they are relative to."""
        if self._loaded is None:
            return []
        return [(each, self._loaded.frames[each.key]) for each in self._loaded.markers]

    def frame(self, key: PlaceKey) -> FrameId | None:
        """The frame of a keyframe of the map, None for another one."""
        return None if self._loaded is None else self._loaded.frames.get(key)

    def has_older(self, segment: int, world: int) -> bool:
        """Whether there may be older worlds, and a segment in a world is in none of them."""
        if world in self.met or world != segment:
            return False
        return self._loaded is not None or segment > 0

    def numbered(
        self, registered: RegisteredKeyframes, frames: dict[PlaceKey, FrameId]
    ) -> RegisteredKeyframes:
        """Keyframes with the run's numbers of worlds; notes which of them are in the map."""
        if self._loaded is None:
            return registered
        last = int(self._loaded.placed.world.max(initial=-1))
        number: dict[int, int] = {}
        for key, world in zip(registered.keys, registered.world.tolist(), strict=True):
            if key in frames:
                segment = frames[key].segment
                number[world] = min(number.get(world, segment), segment)
        self.met = tuple(sorted(n for world, n in number.items() if world <= last))
        metric = self._loaded.header.metric_worlds
        self._metric.by_map = tuple(sorted(n for world, n in number.items() if world in metric))
        world = np.array([number.get(w, w) for w in registered.world.tolist()], np.int64)
        return replace(registered, world=world)
