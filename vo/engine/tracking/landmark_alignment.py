"""Alignment of the map's landmarks in an image, patch by patch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bools, Bytes, Floats, Ints
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.optical_flow import follow
from vo.engine.frontend.patch_alignment import Patches
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.image_masks import used_at
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.lookup import rows_of
from vo.engine.mapping.patch_search import map_homographies
from vo.engine.mapping.tracked_frame import LastFrame, Observations
from vo.engine.tracking.visibility import Visible

# Standard deviation of a patch's position as alignment estimates it: the median in streets, halls
# and corridors; the part of the variance that does not depend on it; and its maximum, in units of
# the median.
_MEDIAN_SIGMA_PX, _CONSTANT_VARIANCE, _MAX_SIGMA = 0.06, 0.4, 4.0
# With fewer converged alignments than this, in units of the minimum number of inliers, those that
# nearly converged are used too: nearly blank walls offer no others.
_ENOUGH = 5


class LandmarkAligner:
    """Finds landmarks in a frame to sub-pixel.

    Attributes:
        world_from_image: (4, 4) predicted pose of the image's view in a rig; else None.
    """

    def __init__(self, local_map: LocalMap, frontend: Frontend, min_inliers: int) -> None:
        self._map = local_map
        self._patches = frontend.patches
        self._stereo = frontend.stereo
        self._min_inliers = min_inliers
        self.world_from_image: Floats | None = None

    def candidates(self, visible: Visible, last: LastFrame | None) -> Visible:
        """The landmarks that can be found: all, by their patches."""
        return visible

    def align(
        self, visible: Visible, frame: PreprocessedFrame, last: LastFrame | None
    ) -> Observations:
        """Find landmarks in a frame that should show them; without disparities."""
        rows = visible.rows
        warp = visible.reference_from_image
        if self.world_from_image is not None:
            targets = self.world_from_image[None], np.zeros(len(rows), np.int64)
            warp = map_homographies(self._map, rows, targets, warp, visible.xy, visible.slope)
        slots, centre = self._map.reference_slots()[rows], self._map.reference_xy[rows]
        references = Patches(self._map.images, slots, centre, warp)
        found = self._patches.align(references, frame.image0, visible.image_xy)
        x, y = (found.xy - visible.image_xy).T
        ideal = self._map.rig.undistort(found.xy)
        kept = found.nearly & self._patches.is_similar(found)
        kept &= x * x + y * y <= self._patches.max_shift_px**2
        kept &= np.isfinite(ideal[:, 0]) & np.isfinite(ideal[:, 1])
        converged = kept & found.converged
        if np.count_nonzero(converged) >= _ENOUGH * self._min_inliers:
            kept = converged
        at = np.flatnonzero(kept)  # taking rows is several times as fast as masking them
        return Observations(
            rows=rows.take(at),
            image_xy=found.xy.take(at, axis=0),
            xy=ideal.take(at, axis=0),
            disparity=np.full(len(at), np.nan),
            sigma_px=self._patches.sigma_px * _relative_sigma(found.sigma_px.take(at)),
            score=found.score.take(at),
            scale=visible.scale.take(at),
            slope=visible.slope.take(at, axis=0),
        )

    def with_disparity(
        self, observed: Observations, world_from_cam: Floats, frame: PreprocessedFrame
    ) -> Observations:
        """The same landmarks with their disparities, where there is a right image or depth."""
        if not frame.has_disparity:
            return observed
        rig = self._map.rig
        in_cam = transform_points(inverse(world_from_cam), self._map.xyz[observed.rows])
        guess = rig.fx * rig.baseline_m / in_cam[:, 2]
        disparity = self._stereo.measure(frame, observed.image_xy, guess, rig, observed.slope)
        return replace(observed, disparity=disparity)


def _relative_sigma(sigma_px: Floats) -> Floats:
    """Standard deviations (n,) of aligned positions, in units of the usual one."""
    relative = np.minimum(sigma_px / _MEDIAN_SIGMA_PX, _MAX_SIGMA)
    return np.asarray(np.sqrt(_CONSTANT_VARIANCE + (1.0 - _CONSTANT_VARIANCE) * relative**2))


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
