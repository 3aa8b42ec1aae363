"""A path of bounded size, which grows coarser instead of longer."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats

_MAX_POSES = 2000


class ThinnedPath:
    """Poses of a run at even intervals of frames, which double whenever there are too many.

    `max_poses`: number of poses at which every second one is left out.
    """

    def __init__(self, max_poses: int = _MAX_POSES) -> None:
        self._max_poses = max_poses
        self._stride = 1
        self._count = 0
        self._frames: list[int] = []
        self._poses: list[Floats] = []

    def __len__(self) -> int:
        return len(self._poses)

    def add(self, frame: int, pose: Floats) -> None:
        """Add the pose (4, 4) of a frame, or leave it out."""
        is_kept = self._count % self._stride == 0
        self._count += 1
        if not is_kept:
            return
        self._frames.append(frame)
        self._poses.append(pose)
        if len(self._poses) >= self._max_poses:
            del self._frames[1::2], self._poses[1::2]
            self._stride *= 2

    def withdraw_from(self, frame: int) -> None:
        """Remove the poses of this frame and all after it."""
        kept = sum(each < frame for each in self._frames)
        del self._frames[kept:], self._poses[kept:]

    def poses(self) -> Floats:
        """The poses (N, 4, 4)."""
        return np.reshape(self._poses, (-1, 4, 4))
