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

import numpy as np

from vo.config import StereoConfig
from vo.faults import Fault, FaultKind
from vo.frontend.contracts import Matcher
from vo.frontend.pair_matching import PairMatcher, PairPoints, View
from vo.frontend.patch_alignment import PatchAligner
from vo.geometry.rectification import RectifiedRig
from vo.geometry.right_camera_error import (
    is_plausible,
    is_worth_correcting,
    largest_change,
    max_row_error,
)
from vo.geometry.vertical_disparity_model import VerticalDisparity, VerticalDisparityFit

_MIN_POINTS = 100  # minimum points that fit, and
_MIN_INLIER_RATIO = 0.5  # minimum ratio of them to all matches
_MAX_PAIRS = 30  # pairs without a result after which estimation is given up
_MIN_CHANGE_PX = 0.05  # of a correction at the image corners; smaller changes are ignored


class VerticalDisparityCorrection:
    """Estimates vertical disparities from pairs at growing intervals and corrects later pairs.

    The first pair with a result is corrected at once; pairs 3, 7, 15, 31 … refine the estimate,
    since each scene leaves something undetermined.

    Attributes:
        estimated: vertical disparities as estimated until now, None without a result.
        corrected: the part of them that is corrected.
        faults: vertical disparities that are too large to be corrected.
        points: points of the newest pair, as it was corrected, None if too few agreed.

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
        self.points: PairPoints | None = None
        self._rig = rig
        self._matcher = PairMatcher(matcher, patches, config.max_disparity_ratio)
        self._is_enabled = config.row_correction
        self._fit = VerticalDisparityFit()
        self._aligned: RectifiedRig | None = None
        self._pairs = 0
        self._next = 0

    def restart(self) -> None:
        """Forget all pairs: what they showed was no rigid scene."""
        self.estimated, self.corrected = None, VerticalDisparity()
        self.faults, self.points = (), None
        self._fit, self._aligned = VerticalDisparityFit(), None
        self._pairs = self._next = 0

    def needs_next_pair(self) -> bool:
        """Whether to estimate from the next pair; to be called once for every pair."""
        self._pairs += 1
        is_over = self.estimated is None and self._pairs > _MAX_PAIRS
        return self._is_enabled and self._pairs > self._next and not is_over

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
        self.points = None
        points = self._matcher.match(left, right)
        if len(points.left) < _MIN_POINTS:
            return False
        xy, found = points
        centre, focal = (self._rig.cx, self._rig.cy), (self._rig.fx, self._rig.fy)
        x, y = ((np.column_stack([found[:, 0], xy[:, 1]]) - centre) / focal).T
        rows_px = found[:, 1] - xy[:, 1] + self.corrected.vertical_px(x, y)
        fit = deepcopy(self._fit)
        inlier = fit.add(x, y, rows_px)
        if np.count_nonzero(inlier) < max(_MIN_POINTS, _MIN_INLIER_RATIO * len(xy)):
            return False
        self.points = points.select(inlier)
        self._fit = fit
        return True
