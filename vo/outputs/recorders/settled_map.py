"""Settled keyframes and landmarks in chunks, each to be logged again when it is re-posed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats, KeyframePose
from vo.outputs.recorders.landmark_history import Points, concatenate
from vo.outputs.recorders.timelines import Moment

_KEYFRAMES_PER_CHUNK = 32  # more make each growth of the newest chunk larger, fewer more entities


class ChunkContent(NamedTuple):
    """One chunk of the settled map at its current place."""

    number: int  # from 0, in order of time
    moment: Moment  # of its newest keyframe or landmark
    keyframes: list[KeyframePose]
    strips: list[Floats]  # the path (N, 3) through them, from the chunk before on; one per segment
    points: Points


@dataclass
class _Chunk:
    moment: Moment
    keyframes: set[int] = field(default_factory=set)
    points: list[Points] = field(default_factory=list)


class SettledMap:
    """What has left the window and the local map.

    `poses`: the current poses of all keyframes by frame number.
    """

    def __init__(self, poses: Mapping[int, KeyframePose]) -> None:
        self._poses = poses
        self._chunk_of: dict[int, int] = {}  # by frame number of settled keyframes
        self._chunks: list[_Chunk] = []
        self._changed: set[int] = set()

    def add_keyframes(self, moment: Moment, keyframes: Iterable[KeyframePose]) -> None:
        """Add newly settled keyframes."""
        for keyframe in keyframes:
            number = len(self._chunk_of) // _KEYFRAMES_PER_CHUNK
            number = self._chunk_of.setdefault(keyframe.frame_index, number)
            self._chunk(moment, number).keyframes.add(keyframe.frame_index)

    def add_points(self, moment: Moment, points: Points) -> None:
        """Add landmarks that have left the local map, each to the chunk of its keyframe."""
        newest = max(len(self._chunks) - 1, 0)  # for keyframes that have not settled yet
        frames = points.keyframe.tolist()
        numbers = np.array([self._chunk_of.get(frame, newest) for frame in frames], np.int64)
        points = replace(points, xyz=points.xyz.astype(np.float32))  # as logged
        for number in np.unique(numbers).tolist():
            self._chunk(moment, number).points.append(points.take(numbers == number))

    def move(self, moves: Mapping[int, Floats]) -> None:
        """Move landmarks with their re-posed keyframes (`KeyframeChanges.moves`)."""
        frames = np.array(list(moves), dtype=np.int64)
        for number, chunk in enumerate(self._chunks):
            points = concatenate(chunk.points)
            has_points = bool(np.isin(points.keyframe, frames).any())
            if has_points:
                chunk.points = [points.moved(moves)]
            is_moved = has_points or not chunk.keyframes.isdisjoint(moves)
            # The path through a chunk begins in the chunk before it.
            begins_moved = number > 0 and not self._chunks[number - 1].keyframes.isdisjoint(moves)
            if is_moved or begins_moved:
                self._changed.add(number)

    def take_changed(self) -> list[ChunkContent]:
        """Chunks that have grown or moved since the last call."""
        changed, self._changed = sorted(self._changed), set()
        return [self._content(number) for number in changed]

    def _chunk(self, moment: Moment, number: int) -> _Chunk:
        """The chunk with a number, to be extended; created if it is the next one."""
        if number == len(self._chunks):
            self._chunks.append(_Chunk(moment))
        chunk = self._chunks[number]
        chunk.moment = moment
        self._changed.add(number)
        return chunk

    def _content(self, number: int) -> ChunkContent:
        chunk = self._chunks[number]
        keyframes = [self._poses[frame] for frame in sorted(chunk.keyframes)]
        before = self._chunks[number - 1].keyframes if number else set()
        chain = [self._poses[max(before)], *keyframes] if before else keyframes
        points = concatenate(chunk.points)
        return ChunkContent(number, chunk.moment, keyframes, _strips(chain), points)


def _strips(chain: Sequence[KeyframePose]) -> list[Floats]:
    segments = np.array([keyframe.segment for keyframe in chain])
    positions = np.array([keyframe.world_from_cam0[:3, 3] for keyframe in chain]).reshape(-1, 3)
    return [positions[segments == segment] for segment in np.unique(segments)]
