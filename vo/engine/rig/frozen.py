"""The view of a rig in which `FrozenCamera` sees whether the rig moves."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats, Ints
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import LastFrame
from vo.engine.rig.tracker import RigTracker
from vo.engine.tracking.sparse_image_alignment import sparse_image_alignment
from vo.engine.tracking.tracker import median_motion_px


class BestView:
    """The view that had the most landmarks in the last frame; see `MovingTracker`."""

    def __init__(self, tracker: RigTracker, local_map: LocalMap) -> None:
        self._tracker = tracker
        self._map = local_map

    @property
    def number(self) -> int:
        """Of the view."""
        last = self._tracker.last
        return 0 if last is None else int(np.argmax([v.inliers for v in last.tracked.views]))

    @property
    def knows_velocity(self) -> bool:
        """See `MovingTracker`."""
        return self._tracker.knows_velocity

    @property
    def last(self) -> LastFrame | None:
        """See `MovingTracker`."""
        last = self._tracker.last
        return None if last is None else last.in_view(self.number)

    def motion_px(self, ids: Ints, stamp_ns: int, last_from_cam: Floats | None = None) -> float:
        """See `MovingTracker`."""
        last, predicted = self._poses(stamp_ns)
        now = predicted if last_from_cam is None else last @ last_from_cam
        return median_motion_px(self._map, ids, last, now)

    def align_to_last(self, frame: PreprocessedFrame) -> Floats | None:
        """See `MovingTracker`."""
        before = self.last
        if before is None:
            return None
        last, predicted = self._poses(frame.stamp_ns)
        return sparse_image_alignment(self._map, before, last, frame, predicted)

    def _poses(self, stamp_ns: int) -> tuple[Floats, Floats]:
        """Those of the view in the last frame, and predicted for a time."""
        tied = self._tracker.body_from_views[self.number]
        motion = self._tracker.motion
        return motion.last @ tied, motion.predict(stamp_ns) @ tied
