"""Paths and graphs that are logged piece by piece, without the viewer.

The log of a run with N frames must not contain N paths of N points each. Therefore the parts that
can still change are logged as a whole in each step, and the rest once, when it settles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vo.base.types import Floats, KeyframePose
from vo.outputs.recorders.keyframe_history import KeyframeChanges


class CausalPath:
    """A path that is logged as one line from each pose to the next."""

    def __init__(self) -> None:
        self._last: Floats | None = None
        self._segment = -1

    def extend(self, position: Floats, segment: int) -> Floats | None:
        """The new line (2, 3), or None at the start of a segment."""
        line = None
        if self._last is not None and segment == self._segment:
            line = np.stack([self._last, position])
        self._last, self._segment = position.copy(), segment
        return line


class SmoothedPath:
    """The path of keyframes: lines between settled ones, and strips through the window."""

    def __init__(self) -> None:
        self._last: KeyframePose | None = None  # the newest settled keyframe

    def update(self, changes: KeyframeChanges, poses: Mapping[int, KeyframePose]) -> list[Floats]:
        """The lines (2, 3) to newly settled keyframes.

        `poses`: current poses by frame number.
        """
        if self._last is not None and changes.moves:
            self._last = poses[self._last.frame_index]
        lines = []
        for keyframe in changes.settled:
            if self._last is not None and self._last.segment == keyframe.segment:
                lines.append(np.stack([_position(self._last), _position(keyframe)]))
            self._last = keyframe
        return lines

    def strips(self, window: Sequence[KeyframePose]) -> list[Floats]:
        """Strips (N, 3) through the window, one per segment, connected to the settled path."""
        chain = list(window) if self._last is None else [self._last, *window]
        segments = np.array([keyframe.segment for keyframe in chain])
        positions = np.array([_position(keyframe) for keyframe in chain])
        return [positions[segments == segment] for segment in np.unique(segments)]


class KeyframeGraph:
    """Edges between keyframes that share landmarks."""

    def __init__(self) -> None:
        self._edges: dict[int, tuple[int, ...]] = {}

    def add(self, frame: int, neighbours: tuple[int, ...]) -> None:
        """Connect a keyframe to older ones, all given by frame number."""
        if neighbours:
            self._edges[frame] = neighbours

    def lines(self, keyframes: Sequence[KeyframePose], poses: Mapping[int, KeyframePose]) -> Floats:
        """The ends (E, 2, 3) of all edges from these keyframes to older ones."""
        frames = {keyframe.frame_index for keyframe in keyframes} & poses.keys()
        ends = [
            (_position(poses[a]), _position(poses[b]))
            for a in sorted(frames & self._edges.keys())
            for b in self._edges[a]
            if b in poses
        ]
        return np.array(ends).reshape(-1, 2, 3)


def _position(keyframe: KeyframePose) -> Floats:
    return keyframe.world_from_cam0[:3, 3]
