"""The path so far: each tracked frame hangs on a keyframe and moves with it."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from vo.geometry.transforms import inverse
from vo.types import Floats, KeyframePose, Trajectory


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A frame with a pose: which keyframe it hangs on and where it is against that."""

    frame_index: int
    stamp_ns: int
    segment: int
    keyframe: int
    keyframe_from_cam: Floats


class History:
    """Tracked frames in time order, and the newest pose of every keyframe."""

    def __init__(self) -> None:
        self.frames: list[TrackedFrame] = []
        self.keyframes: dict[int, KeyframePose] = {}

    def add(
        self, frame_index: int, stamp_ns: int, segment: int, keyframe: int, world_from_cam0: Floats
    ) -> None:
        """Append a frame that hangs on a keyframe."""
        relative = inverse(self.keyframes[keyframe].world_from_cam0) @ world_from_cam0
        self.frames.append(TrackedFrame(frame_index, stamp_ns, segment, keyframe, relative))

    def pose(self, frame: TrackedFrame) -> Floats:
        """world_from_cam0 of a frame as known now."""
        return self.keyframes[frame.keyframe].world_from_cam0 @ frame.keyframe_from_cam

    def first_row(self, frame_index: int) -> int:
        """Row in `frames` of the first frame with this number or a higher one."""
        return bisect_left(self.frames, frame_index, key=lambda frame: frame.frame_index)

    def first_keyframe_row(self, frame_index: int) -> int:
        """Place in `keyframes` of the first keyframe with this frame number or a higher one."""
        keyframes = list(self.keyframes.values())
        return bisect_left(keyframes, frame_index, key=lambda keyframe: keyframe.frame_index)

    def trajectory(self) -> Trajectory:
        """All tracked frames as known now."""
        if not self.frames:
            return Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4)))
        stamps = np.array([f.stamp_ns for f in self.frames], dtype=np.int64)
        return Trajectory(stamps, np.stack([self.pose(f) for f in self.frames]))
