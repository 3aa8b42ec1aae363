"""Estimation and correction of vertical disparities, before features are matched along rows.

A camera that was bumped after its calibration has vertical disparities of several pixels, too many
for matching along rows, and horizontal disparities that are wrong from place to place, which costs
several per cent of the scale. Most of the error can be estimated from rows: it is corrected in the
rectification maps, together with its effect on disparities. What rows cannot show, a constant bias
of all disparities, is the subject of `vo.engine.refinement.disparity_bias`.

Source: Hansen et al., "Online Continuous Stereo Extrinsic Parameter Estimation", CVPR 2012 (angles
of the right camera from rows).
"""

from __future__ import annotations

from copy import deepcopy
from typing import NamedTuple

import numpy as np

from vo.base.config import StereoConfig
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import (
    FittedVerticalDisparity,
    VerticalDisparity,
    VerticalDisparityFit,
)
from vo.engine.frontend.contracts import Matcher
from vo.engine.frontend.pair_matching import PairMatcher, PairPoints, View
from vo.engine.frontend.patch_alignment import PatchAligner
from vo.engine.geometry.right_camera_error import (
    is_large,
    is_plausible,
    is_worth_correcting,
    largest_change,
    max_row_error,
)

_MIN_POINTS = 100  # minimum points that fit, and
_MIN_INLIER_RATIO = 0.5  # minimum ratio of them to all matches
_MAX_PAIRS = 30  # pairs without a result after which estimation is given up
_MIN_GAIN, _MIN_CONFIRMATIONS = 4.0, 2  # of chi^2 in a pair, and the number of such pairs
_MIN_CHANGE_PX = 0.05  # of a correction at the image corners; smaller changes are ignored


class _Support(NamedTuple):
    """How well the fit explains pairs that were not in it yet.

    Attributes:
        chi2: gain over no error, of the newest pairs.
        confirmations: number of the newest pairs that all confirm it.
    """

    chi2: float = 0.0
    confirmations: int = 0

    def after(self, gain: float) -> _Support:
        """With a pair whose chi^2 the fit reduces by `gain`."""
        confirmations = self.confirmations + 1 if gain > _MIN_GAIN else 0
        return _Support(0.5 * self.chi2 + gain, confirmations)


class VerticalDisparityCorrection:
    """Estimates vertical disparities from pairs at growing intervals and corrects later pairs.

    Pairs 1, 3, 7, 15, 31 … are used, since each scene leaves something undetermined. Large errors
    are corrected at once, small ones when two further pairs are explained better with the
    correction than without it. Once pairs are explained better without, it is taken back.

    Attributes:
        estimated: vertical disparities as estimated until now, None without a result.
        corrected: the part of them that is corrected.
        faults: vertical disparities that are too large to be corrected.
        points: points of the newest pair, as it was corrected, None if too few agreed.
        matches: all matched points of the newest pair, with rows as calibrated.
    """

    def __init__(
        self, rig: RectifiedRig, matcher: Matcher, patches: PatchAligner, config: StereoConfig
    ) -> None:
        self.estimated: VerticalDisparity | None = None
        self.corrected = VerticalDisparity()
        self.faults: tuple[Fault, ...] = ()
        self.points: PairPoints | None = None
        self.matches = PairPoints(np.empty((0, 2)), np.empty((0, 2)))
        self._rig = rig
        self._matcher = PairMatcher(matcher, patches, config.max_disparity_ratio)
        self._is_enabled = config.row_correction
        self._fit = VerticalDisparityFit()
        self._support = _Support()
        self._corrects = False
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
        self._corrects = self._is_certain(fitted)
        correction = fitted.errors if self._corrects else VerticalDisparity()
        self.faults = ()
        if not is_plausible(correction, self._rig):
            rows_px = max_row_error(correction, self._rig)
            self.faults = (Fault(FaultKind.DIFFERENT_ROWS, value=rows_px),)
            correction = VerticalDisparity()
        if largest_change(self.corrected, correction, self._rig) < _MIN_CHANGE_PX:
            return False
        self.corrected = correction
        self._aligned = self._rig.with_right_corrected(correction)
        return True

    def aligned_rig(self) -> RectifiedRig:
        """The rig that rectifies right images with the correction, if there is one."""
        return self._rig if self._aligned is None else self._aligned

    def _is_certain(self, fitted: FittedVerticalDisparity) -> bool:
        """Whether to correct an error, or to go on correcting it."""
        if self._corrects:
            return True
        is_confirmed = self._support.confirmations >= _MIN_CONFIRMATIONS
        is_certain = is_confirmed or is_large(fitted.errors, self._rig)
        return is_certain and is_worth_correcting(fitted, self._rig)

    def _add(self, left: View, right: View) -> bool:
        """Add a pair to the fit; whether enough of its points agree."""
        self.points = None
        points = self._matcher.match(left, right)
        xy, found = points
        centre, focal = (self._rig.cx, self._rig.cy), (self._rig.fx, self._rig.fy)
        x, y = ((np.column_stack([found[:, 0], xy[:, 1]]) - centre) / focal).T
        rows_px = found[:, 1] - xy[:, 1] + self.corrected.vertical_px(x, y)
        self.matches = PairPoints(xy, np.column_stack([found[:, 0], xy[:, 1] + rows_px]))
        if len(xy) < _MIN_POINTS:
            return False
        support, fit = self._support, deepcopy(self._fit)
        if self.estimated is not None:
            support = support.after(fit.support(x, y, rows_px))
        is_refuted = self._corrects and support.chi2 < 0.0
        if is_refuted:
            support, fit = _Support(), VerticalDisparityFit()
        inlier = fit.add(x, y, rows_px, xy[:, 0] - found[:, 0])
        if np.count_nonzero(inlier) < max(_MIN_POINTS, _MIN_INLIER_RATIO * len(xy)):
            return False
        self.points = points.select(inlier)
        self._fit, self._support = fit, support
        self._corrects = self._corrects and not is_refuted
        return True
