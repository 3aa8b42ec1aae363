"""The map's landmarks by optical flow (KLT), from the last frame or the newest keyframe."""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools, Bytes, Floats, Ints
from vo.engine.frontend.optical_flow import follow
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.image_masks import used_at
from vo.engine.mapping.lookup import rows_of
from vo.engine.mapping.tracked_frame import Observations
from vo.engine.tracking.landmark_alignment import LandmarkAligner
from vo.engine.tracking.last_frame import LastFrame
from vo.engine.tracking.visibility import Visible


class KltAligner(LandmarkAligner):
    """Follows landmarks from image to image; one that is lost once is not found again.

    Where a landmark was in the last frame, it is followed from there, else from the newest
    keyframe, which has seen the new ones.
    """

    def candidates(self, visible: Visible, last: LastFrame | None) -> Visible:
        """The landmarks that were in the last frame, or in the newest keyframe."""
        in_last, in_keyframe = self._places(visible.rows, last)
        return visible.select(np.flatnonzero((in_last >= 0) | (in_keyframe >= 0)))

    def align(
        self, visible: Visible, frame: PreprocessedFrame, last: LastFrame | None
    ) -> Observations:
        """Find landmarks in a frame; without disparities."""
        in_last, in_keyframe = self._places(visible.rows, last)
        xy, found = np.zeros((len(in_last), 2)), np.zeros(len(in_last), dtype=bool)
        if last is not None:
            chosen = np.flatnonzero(in_last >= 0)
            source = last.frame.image0, last.image_xy[in_last[chosen]]
            self._follow(source, frame.image0, visible.image_xy, chosen, (xy, found))
        newest = self._map.keyframes[-1]
        chosen = np.flatnonzero((in_last < 0) & (in_keyframe >= 0))
        source = self._map.images[newest.slot], newest.image_xy[in_keyframe[chosen]]
        self._follow(source, frame.image0, visible.image_xy, chosen, (xy, found))
        if frame.masks[0] is not None:
            found[found] = used_at(frame.masks[0], xy[found])
        ideal = self._map.rig.undistort(xy)
        at = np.flatnonzero(found & np.isfinite(ideal).all(axis=1))
        return Observations(
            rows=visible.rows[at],
            image_xy=xy[at],
            xy=ideal[at],
            disparity=np.full(len(at), np.nan),
            sigma_px=np.full(len(at), self._patches.sigma_px),
            score=np.ones(len(at)),
            scale=visible.scale[at],
            slope=visible.slope[at],
        )

    def _places(self, rows: Ints, last: LastFrame | None) -> tuple[Ints, Ints]:
        """Row of each landmark in the last frame, and in the newest keyframe; -1 where absent."""
        ids = self._map.id[rows]
        in_last = np.full(len(rows), -1) if last is None else rows_of(ids, last.ids)
        observed = self._map.keyframes[-1].landmark
        order = np.argsort(observed)
        place = rows_of(ids, observed[order])
        in_keyframe = np.where(place >= 0, order[np.maximum(place, 0)] if len(order) else -1, -1)
        if last is not None:  # what disagreed with the pose has slid off its landmark
            is_lost = (in_last >= 0) & ~last.inlier[np.maximum(in_last, 0)]
            in_last, in_keyframe = (
                np.where(is_lost, -1, in_last),
                np.where(is_lost, -1, in_keyframe),
            )
        return in_last, in_keyframe

    @staticmethod
    def _follow(
        source: tuple[Bytes, Floats],
        image: Bytes,
        start_xy: Floats,
        chosen: Ints,
        result: tuple[Floats, Bools],
    ) -> None:
        flow = follow(source[0], image, source[1], start_xy[chosen])
        result[0][chosen], result[1][chosen] = flow.xy, flow.found
