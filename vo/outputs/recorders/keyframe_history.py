"""Poses of all keyframes of a run: in the optimisation window, settled, re-posed later."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, KeyframePose, Snapshot


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
