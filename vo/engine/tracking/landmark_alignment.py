"""Alignment of the map's landmarks in an image, patch by patch."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.transforms import inverse
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
        slots = self._map.reference_slots(rows)
        references = Patches(self._map.images, slots, self._map.reference_xy.take(rows, 0), warp)
        found = self._patches.align(references, frame.image0, visible.image_xy)
        chosen = _chosen(
            (found.xy, self._map.rig.undistort(found.xy), found.sigma_px, found.score),
            (found.converged, found.nearly, self._patches.is_similar(found)),
            (rows, visible.image_xy, visible.scale, visible.slope),
            (self._patches.max_shift_px**2, _ENOUGH * self._min_inliers, self._patches.sigma_px),
        )
        return Observations(*chosen)

    def with_disparity(
        self, observed: Observations, world_from_cam: Floats, frame: PreprocessedFrame
    ) -> Observations:
        """The same landmarks with their disparities, where there is a right image or depth."""
        if not frame.has_disparity:
            return observed
        rig = self._map.rig
        xyz = self._map.xyz.take(observed.rows, axis=0)  # several times as fast as [rows]
        cam_from_world = inverse(world_from_cam)
        depth = (xyz @ cam_from_world[:3, :3].T)[:, 2] + cam_from_world[2, 3]
        guess = rig.fx * rig.baseline_m / depth
        disparity = self._stereo.measure(frame, observed.image_xy, guess, rig, observed.slope)
        return observed.with_disparity(disparity)


@compiled
def _chosen(found, is_good, visible, limits):  # type: ignore[no-untyped-def]
    """Observations of what was found near enough to where it should be, in the order of fields."""
    (xy, ideal, sigma, score), (converged, nearly, similar) = found, is_good
    (rows, expected, scale, slope), (max_squared, enough, sigma_px) = visible, limits
    count, sure, at = 0, 0, np.empty(len(rows), dtype=np.int64)
    for n in range(len(rows)):
        x, y = xy[n, 0] - expected[n, 0], xy[n, 1] - expected[n, 1]
        is_known = np.isfinite(ideal[n, 0]) and np.isfinite(ideal[n, 1])
        if nearly[n] and similar[n] and x * x + y * y <= max_squared and is_known:
            at[count], count, sure = n, count + 1, sure + int(converged[n])
    only_sure = sure >= enough
    n = sure if only_sure else count
    ids, image_xy, ideal_xy = np.empty(n, np.int64), np.empty((n, 2)), np.empty((n, 2))
    disparity, sigmas, scores, scales = np.full(n, np.nan), np.empty(n), np.empty(n), np.empty(n)
    slopes = np.empty((n, 2))
    to = 0
    for k in at[:count]:
        if only_sure and not converged[k]:
            continue
        ids[to], scores[to], scales[to] = rows[k], score[k], scale[k]
        for m in range(2):
            image_xy[to, m], ideal_xy[to, m], slopes[to, m] = xy[k, m], ideal[k, m], slope[k, m]
        relative = min(sigma[k] / _MEDIAN_SIGMA_PX, _MAX_SIGMA)
        variance = _CONSTANT_VARIANCE + (1.0 - _CONSTANT_VARIANCE) * (relative * relative)
        sigmas[to] = sigma_px * np.sqrt(variance)
        to += 1
    return ids, image_xy, ideal_xy, disparity, sigmas, scores, scales, slopes


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
