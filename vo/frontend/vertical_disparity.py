"""Estimation and correction of vertical disparities, before features are matched along rows.

A camera that was bumped after its calibration has vertical disparities of several pixels, too many
for matching along rows, and horizontal disparities that are wrong from place to place, which costs
several per cent of the scale. Most of the error can be estimated from rows: it is corrected in the
rectification maps, together with its effect on disparities. What rows cannot show, a constant bias
of all disparities, is the subject of `vo.refinement.disparity_bias`.

Source: Hansen et al., "Online Continuous Stereo Extrinsic Parameter Estimation", CVPR 2012 (angles
of the right camera from rows).
"""

from __future__ import annotations

from copy import deepcopy
from typing import NamedTuple

import numpy as np

from vo.config import StereoConfig
from vo.faults import Fault, FaultKind
from vo.frontend.contracts import EpipolarSegments, Matcher, feature_set
from vo.frontend.patch_alignment import PatchAligner, patches_of
from vo.geometry.rectification import RectifiedRig
from vo.geometry.right_camera_error import (
    is_plausible,
    is_worth_correcting,
    largest_change,
    max_row_error,
)
from vo.geometry.vertical_disparity_model import VerticalDisparity, VerticalDisparityFit
from vo.types import Bytes, Floats, Keypoints

_MAX_OFFSET_RATIO = 0.06  # search range across rows, ratio of the image height
_MIN_POINTS = 100  # minimum points that fit, and
_MIN_INLIER_RATIO = 0.5  # minimum ratio of them to all matches
_RATIO = 0.8  # ratio test; stricter than in tracking, as the search range is wide
_MAX_PAIRS = 30  # pairs without a result after which estimation is given up
_MIN_CHANGE_PX = 0.05  # of a correction at the image corners; smaller changes are ignored


class View(NamedTuple):
    """A rectified image and its features."""

    image: Bytes
    keypoints: Keypoints


class VerticalDisparityCorrection:
    """Estimates vertical disparities from pairs at growing intervals and corrects later pairs.

    The first pair with a result is corrected at once; pairs 3, 7, 15, 31 … refine the estimate,
    since each scene leaves something undetermined.

    Attributes:
        estimated: vertical disparities as estimated until now, None without a result.
        corrected: the part of them that is corrected.
        faults: vertical disparities that are too large to be corrected.

    Args:
        rig: the rectified cameras as calibrated.
        matcher: matches left and right features.
        patches: aligns patches.
        config: stereo settings.
    """

    def __init__(
        self, rig: RectifiedRig, matcher: Matcher, patches: PatchAligner, config: StereoConfig
    ) -> None:
        self.estimated: VerticalDisparity | None = None
        self.corrected = VerticalDisparity()
        self.faults: tuple[Fault, ...] = ()
        self._rig = rig
        self._matcher = matcher
        self._patches = patches
        self._config = config
        self._fit = VerticalDisparityFit()
        self._aligned: RectifiedRig | None = None
        self._pairs = 0
        self._next = 0

    def needs_next_pair(self) -> bool:
        """Whether to estimate from the next pair; to be called once for every pair."""
        self._pairs += 1
        is_over = self.estimated is None and self._pairs > _MAX_PAIRS
        return self._config.row_correction and self._pairs > self._next and not is_over

    def update(self, left: View, right: View) -> bool:
        """Estimate from a pair as it is corrected now; whether the correction has changed."""
        has_result = self._add(left, right)
        if has_result or self.estimated is not None:  # dark pairs, too, count for the intervals
            self._next = 2 * self._pairs
        if not has_result:
            return False
        fitted = self._fit.result()
        self.estimated = fitted.errors
        corrects = self._aligned is not None or is_worth_correcting(fitted, self._rig)
        self.faults = ()
        if corrects and not is_plausible(fitted.errors, self._rig):
            rows_px = max_row_error(fitted.errors, self._rig)
            corrects, self.faults = False, (Fault(FaultKind.DIFFERENT_ROWS, value=rows_px),)
        correction = fitted.errors if corrects else VerticalDisparity()
        if largest_change(self.corrected, correction, self._rig) < _MIN_CHANGE_PX:
            return False
        self.corrected = correction
        self._aligned = self._rig.with_right_corrected(correction)
        return True

    def aligned_rig(self) -> RectifiedRig:
        """The rig that rectifies right images with the correction, if there is one."""
        return self._rig if self._aligned is None else self._aligned

    def _add(self, left: View, right: View) -> bool:
        """Add a pair to the fit; whether enough of its points agree."""
        xy, found = self._match(left, right)
        if len(xy) < _MIN_POINTS:
            return False
        centre, focal = (self._rig.cx, self._rig.cy), (self._rig.fx, self._rig.fy)
        x, y = ((np.column_stack([found[:, 0], xy[:, 1]]) - centre) / focal).T
        rows_px = found[:, 1] - xy[:, 1] + self.corrected.vertical_px(x, y)
        fit = deepcopy(self._fit)
        inliers = np.count_nonzero(fit.add(x, y, rows_px))
        if inliers < max(_MIN_POINTS, _MIN_INLIER_RATIO * len(xy)):
            return False
        self._fit = fit
        return True

    def _match(self, left: View, right: View) -> tuple[Floats, Floats]:
        """Pixels (N, 2) of features in the left image, and of the same points in the right one."""
        height, width = left.image.shape
        xy = left.keypoints.xy.astype(np.float64)
        reach = _MAX_OFFSET_RATIO * height
        region = EpipolarSegments(
            xy - (self._config.max_disparity_ratio * width, 0.0),
            xy + (reach, 0.0),
            np.full(len(right.keypoints), reach),
        )
        matches = self._matcher.match(
            feature_set(left.keypoints),
            feature_set(right.keypoints),
            region,
            ratio=_RATIO,
            check_rotation=False,
        )
        start = right.keypoints.xy[matches.train].astype(np.float64)
        found = self._patches.align(patches_of(left.image, xy[matches.query]), right.image, start)
        good = self._patches.is_found(found)
        return xy[matches.query[good]], found.xy[good]
