"""Poses of all keyframes of a run: in the optimisation window, settled, re-posed later."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.records.snapshot import Snapshot
from vo.base.types import Floats, KeyframePose


class KeyframeChanges(NamedTuple):
    """Changes of keyframe poses in one step."""

    optimised: Sequence[KeyframePose]  # keyframes that were added, or moved by local optimisation
    settled: Sequence[KeyframePose]  # keyframes that have left the window, oldest first
    # of a step in which old keyframes were re-posed, as after a loop closure: the motion (4, 4) of
    # each of its keyframes in the world, by frame number; a similarity where the scale of the
    # keyframe has changed, too. It moves landmarks with their keyframe. Empty for other steps
    moves: Mapping[int, Floats]


class KeyframeHistory:
    """The current poses of all keyframes so far.

    Local optimisation moves the newest keyframes only; these are the window. Keyframes older than
    the window are settled. A settled keyframe that has left the local map can still get a new
    pose: it is re-posed.

    `poses`: by frame number.
    """

    def __init__(self) -> None:
        self.poses: dict[int, KeyframePose] = {}
        self._window: set[int] = set()
        self._map_frames: set[int] = set()  # of keyframes in the local map

    @property
    def newest(self) -> int:
        """Frame number of the newest keyframe, -1 without one."""
        return next(reversed(self.poses), -1)

    @property
    def window(self) -> list[KeyframePose]:
        """Keyframes that local optimisation may still move, oldest first."""
        return [self.poses[frame] for frame in sorted(self._window)]

    def update(self, keyframes: Sequence[KeyframePose], snapshot: Snapshot) -> KeyframeChanges:
        """Store keyframes that were added or moved.

        `keyframes`: `Estimate.keyframes`.
        """
        reposed = self._reposed(keyframes, snapshot)
        moves = self._moves(keyframes) if reposed else {}
        optimised = [k for k in keyframes if k.frame_index not in reposed]
        self.poses.update({k.frame_index: k for k in keyframes})
        return KeyframeChanges(optimised, self._move_window(optimised), moves)

    def _reposed(self, keyframes: Sequence[KeyframePose], snapshot: Snapshot) -> set[int]:
        """Frames of settled keyframes with new poses, if one of them is outside of the map."""
        before = self._map_frames
        if snapshot.landmarks is not None:
            self._map_frames = {each.frame_index for each in snapshot.landmarks.sightings}
        # Keyframes of a map that was replaced in this step were moved by local optimisation.
        local = before | self._map_frames | self._window
        known = {k.frame_index for k in keyframes} & self.poses.keys()
        return known - self._window if known - local else set()

    def _moves(self, keyframes: Iterable[KeyframePose]) -> dict[int, Floats]:
        return {
            k.frame_index: _motion(self.poses[k.frame_index], k)
            for k in keyframes
            if k.frame_index in self.poses
        }

    def _move_window(self, optimised: Sequence[KeyframePose]) -> list[KeyframePose]:
        """Move the window to the optimised keyframes; the keyframes that leave it."""
        if not optimised:
            return []
        frames = {k.frame_index for k in optimised}
        leaving = sorted(frame for frame in self._window if frame < min(frames))
        self._window = (self._window - set(leaving)) | frames
        return [self.poses[frame] for frame in leaving]


def _motion(old: KeyframePose, new: KeyframePose) -> Floats:
    in_cam0 = inverse(old.world_from_cam0)
    in_cam0[:3] *= new.scale / old.scale
    return np.asarray(new.world_from_cam0 @ in_cam0)


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
