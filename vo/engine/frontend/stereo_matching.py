"""Stereo matching: sub-pixel disparities of features and patches in a rectified pair."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.config import StereoConfig
from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Floats, Floats32, Ints
from vo.engine.frontend.contracts import EpipolarSegments, FeatureExtractor, Matcher, feature_set
from vo.engine.frontend.patch_alignment import PatchAligner, patches_of
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.image_masks import used_at
from vo.engine.geometry.neighbours import NEIGHBOURS, median_of_nearest
from vo.engine.geometry.surfaces import inverse_depth_slopes, left_from_right

_RATIO = 0.9  # ratio test; looser than in tracking, as the search is along one row
# Maximum difference between a measured disparity and its guess: pixels, and ratio of the guess.
_MAX_CHANGE_PX, _MAX_CHANGE_RATIO = 3.0, 0.2


class StereoMatcher:
    """Measures disparities, from a right image or from measured depth."""

    def __init__(
        self,
        extractor: FeatureExtractor,
        matcher: Matcher,
        patches: PatchAligner,
        config: StereoConfig,
    ) -> None:
        self._scale_factor = extractor.scale_factor
        self._matcher = matcher
        self._patches = patches
        self._config = config

    @property
    def sigma_disparity_px(self) -> float:
        """Standard deviation of a disparity, pixels."""
        return self._config.sigma_disparity_px

    @property
    def min_disparity_px(self) -> float:
        """Minimum disparity of a new landmark, pixels."""
        return self._config.min_disparity_px

    def measure(
        self,
        frame: PreprocessedFrame,
        xy: Floats,
        guess: Floats,
        rig: RectifiedRig,
        slope: Floats | None = None,
    ) -> Floats:
        """Sub-pixel disparities (n,) at pixels (n, 2) of the left image, NaN where there is none.

        `guess` (n,) is expected; `slope` (n, 2), 1/px, is the change of inverse depth relative to
        it, as the right camera sees inclined surfaces sheared. Without right image and depth all
        are NaN.
        """
        if frame.depth is not None:
            return disparity_from_depth(frame.depth, xy, rig)
        if frame.right is None:
            return np.full(len(xy), np.nan)
        return self._measure_in_pair(frame, xy, guess, rig, slope)

    def disparities(self, frame: PreprocessedFrame, rows: Ints, rig: RectifiedRig) -> Floats:
        """Sub-pixel disparities (n,) of some features of a frame, NaN where there is none."""
        left = frame.keypoints
        xy = left.xy[rows].astype(np.float64)
        if frame.depth is not None:
            return disparity_from_depth(frame.depth, xy, rig)
        assert frame.right is not None
        right = frame.right[1].result()
        width = frame.image0.shape[1]
        max_offset = self._config.max_row_offset_px
        region = EpipolarSegments(
            xy - (self._config.max_disparity_ratio * width, 0.0),
            xy + (max_offset, 0.0),
            max_offset * self._scale_factor ** right.octave.astype(np.float64),
        )
        matches = self._matcher.match(
            feature_set(left, rows),
            feature_set(right),
            region,
            ratio=_RATIO,
            check_rotation=False,
        )
        found = matches.query
        disparity = np.full(len(rows), np.nan)
        guess = rig.ideal_disparity(xy[found], right.xy[matches.train].astype(np.float64))
        disparity[found] = self._measure_in_pair(frame, xy[found], guess, rig)
        disparity = self._fill_from_neighbours(disparity, xy, frame, rig)
        return self._measure_on_surfaces(disparity, xy, frame, rig)

    def _measure_in_pair(
        self,
        frame: PreprocessedFrame,
        xy: Floats,
        guess: Floats,
        rig: RectifiedRig,
        slope: Floats | None = None,
    ) -> Floats:
        assert frame.right is not None
        image0, image1, mask = frame.image0, frame.right[0], frame.masks[1]
        start = rig.right_pixels(xy, guess)
        shear = None if slope is None else left_from_right(guess, slope)
        found = self._patches.align(patches_of(image0, xy, shear), image1, start)
        disparity = rig.ideal_disparity(xy, found.xy)
        is_similar = self._patches.is_similar(found)
        limits = self._config.max_row_offset_px, _MAX_CHANGE_PX, _MAX_CHANGE_RATIO
        measured = _accepted(disparity, guess, xy, found.xy, found.converged, is_similar, limits)
        if mask is not None:
            known = np.flatnonzero(~np.isnan(measured))
            hidden = known[~used_at(mask, found.xy[known])]
            measured[hidden] = np.nan
        return np.asarray(measured)

    def _fill_from_neighbours(
        self, disparity: Floats, xy: Floats, frame: PreprocessedFrame, rig: RectifiedRig
    ) -> Floats:
        """Try features without a match, such as those in grass, at their neighbours' disparity."""
        is_known = ~np.isnan(disparity)
        known, missing = np.flatnonzero(is_known), np.flatnonzero(~is_known)
        if len(known) < NEIGHBOURS or len(missing) == 0:
            return disparity
        guess = median_of_nearest(xy[missing], xy[known], disparity[known])
        filled = disparity.copy()
        filled[missing] = self._measure_in_pair(frame, xy[missing], guess, rig)
        return filled

    def _measure_on_surfaces(
        self, disparity: Floats, xy: Floats, frame: PreprocessedFrame, rig: RectifiedRig
    ) -> Floats:
        """Measure disparities again with the shear that follows from neighbouring disparities."""
        known = np.flatnonzero(disparity > 0.0)
        at, guess = xy[known], disparity[known]
        slope = inverse_depth_slopes(rig.undistort(at), guess, np.arange(len(known)))
        again = self._measure_in_pair(frame, at, guess, rig, slope)
        measured = disparity.copy()
        measured[known] = np.where(np.isnan(again), guess, again)
        return measured


@compiled
def _accepted(disparity, guess, xy, found_xy, converged, similar, limits):  # type: ignore[no-untyped-def]
    """Disparities (n,), NaN where the patch was not found near to where it should be."""
    max_row_offset, max_change, max_change_ratio = limits
    accepted = np.full(len(disparity), np.nan)
    for n in range(len(disparity)):
        if not (converged[n] and similar[n] and disparity[n] > 0.0):
            continue
        change, farthest = (
            abs(disparity[n] - guess[n]),
            max(max_change, max_change_ratio * guess[n]),
        )
        if change <= farthest and abs(found_xy[n, 1] - xy[n, 1]) <= max_row_offset:
            accepted[n] = disparity[n]
    return accepted


# Maximum ratio of the largest to the smallest depth around a pixel; a larger one is an edge.
_MAX_SPREAD = 1.05


def disparity_from_depth(depth: Floats32, image_xy: Floats, rig: RectifiedRig) -> Floats:
    """Disparity (n,) in pixels at image pixels (n, 2), NaN where depth is unknown.

    Landmarks, residuals and windows treat it like a stereo disparity. Between pixels inverse depth
    is interpolated, which is exact on planes; at edges there is none, as both sides are possible.

    Depth (H, W) is in metres along the optical axis, 0 where unknown.

    Source: Mur-Artal and Tardos, ORB-SLAM2, 2017, eq. 1.
    """
    height, width = depth.shape
    corner = np.floor(image_xy).astype(np.int64)
    inside = np.asarray((corner >= 0).all(axis=1) & (corner < (width - 1, height - 1)).all(axis=1))
    u, v = np.where(inside[:, None], corner, 0).T
    around = np.stack([depth[v, u], depth[v, u + 1], depth[v + 1, u], depth[v + 1, u + 1]])
    around = around.astype(np.float64)
    nearest, farthest = around.min(axis=0), around.max(axis=0)
    known = inside & (nearest > 0.0) & (farthest < _MAX_SPREAD * nearest)
    fraction = image_xy - corner
    across, down = fraction[:, 0], fraction[:, 1]
    weights = np.stack(
        [(1 - across) * (1 - down), across * (1 - down), (1 - across) * down, across * down]
    )
    inverse_depth = (weights / np.where(around > 0.0, around, 1.0)).sum(axis=0)
    return np.where(known, rig.fx * rig.baseline_m * inverse_depth, np.nan)
