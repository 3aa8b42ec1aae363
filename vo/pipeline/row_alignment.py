"""Brings the rows of pairs in line before the first frame is placed.

A camera that was bumped since it was calibrated has rows that are pixels off, too far for matching
along rows, and disparities that err from place to place, which costs several per cent of the scale
before anything looks wrong. Rows tell most of it: they are corrected, and what follows from them
for disparities with them. What they cannot tell, a constant error of all disparities, is left to
`vo.pipeline.disparity_watch`.

Source: Hansen et al., "Online Continuous Stereo Extrinsic Parameter Estimation", CVPR 2012 (the
right camera's angles from rows).
"""

from __future__ import annotations

from copy import deepcopy
from typing import NamedTuple

import numpy as np

from vo.config import Config
from vo.features.alignment import align_between
from vo.features.matching import match_segments
from vo.geometry.rectification import WorkingRig
from vo.geometry.row_errors import FittedRows, RowErrors, RowFit, sigma_of_rows
from vo.types import Bytes, Floats, Keypoints, RightCamera

_FARTHEST = 0.06  # rows are looked for within this share of the image's height
_FEWEST = 100  # points that must agree, and
_LEAST_SHARE = 0.5  # of all that were matched
_RATIO = 0.8
_SURE = 2.0  # standard deviations
_MOST_PAIRS = 30  # that are asked before it is given up if none tells
# Less is left alone: nothing is lost by it, and images that are used as recorded stay as they are.
_LEAST_CHANGE_PX = 0.05
_WORTH_PX, _WORTH_WITH_SKEW_PX = 0.5, 2.0


class View(NamedTuple):
    """A working image and its features."""

    image: Bytes
    keypoints: Keypoints


class RowAlignment:
    """Learns from pairs, ever more seldom, and corrects those that follow.

    The first pair that tells is corrected at once; pairs number 3, 7, 15, 31 … make it more exact:
    what one scene leaves open another one shows.

    Attributes:
        found: what pairs said until now, if one has told.
        corrected: what is corrected of that.
    """

    def __init__(self, config: Config) -> None:
        self.found: RowErrors | None = None
        self.corrected = RowErrors()
        self._config = config
        self._fit = RowFit()
        self._aligned: WorkingRig | None = None
        self._pairs = 0
        self._next = 0

    def asks(self) -> bool:
        """Whether the next pair is to be learned from; to be called for every pair, once."""
        self._pairs += 1
        is_over = self.found is None and self._pairs > _MOST_PAIRS
        return self._config.stereo.row_correction and self._pairs > self._next and not is_over

    def learn(self, left: View, right: View, rig: WorkingRig) -> bool:
        """Take in a pair, as it is corrected now; whether the correction has changed."""
        if not self._take_in(left, right, rig):
            return False
        self._next = 2 * self._pairs
        fitted = self._fit.result()
        self.found = fitted.errors
        corrects = self._aligned is not None or _is_worth_it(fitted, rig)
        wanted = fitted.errors if corrects else RowErrors()
        if _largest_change(self.corrected, wanted, rig) < _LEAST_CHANGE_PX:
            return False
        self.corrected = wanted
        self._aligned = rig.with_right_corrected(wanted)
        return True

    def aligned(self, rig: WorkingRig) -> WorkingRig:
        """The rig with its right images corrected, if there is something to correct."""
        return rig if self._aligned is None else self._aligned

    def _take_in(self, left: View, right: View, rig: WorkingRig) -> bool:
        """Learn from a pair, if it tells."""
        xy, found = _matched(left, right, self._config)
        if len(xy) < _FEWEST:
            return False
        centre, focal = (rig.cx, rig.cy), (rig.fx, rig.fy)
        x, y = ((np.column_stack([found[:, 0], xy[:, 1]]) - centre) / focal).T
        rows_px = found[:, 1] - xy[:, 1] + self.corrected.rows_px(x, y)
        fit = deepcopy(self._fit)
        if np.count_nonzero(fit.add(x, y, rows_px)) < max(_FEWEST, _LEAST_SHARE * len(xy)):
            return False
        self._fit = fit
        return True


def _matched(left: View, right: View, config: Config) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of features of the left image and where they are in the right one."""
    height, width = left.image.shape
    a, b = left.keypoints, right.keypoints
    xy = a.xy.astype(np.float64)
    reach = _FARTHEST * height
    matched = match_segments(
        a.octave,
        a.descriptor,
        b.xy.astype(np.float64),
        b.octave,
        b.descriptor,
        xy - (config.stereo.max_disparity_share * width, 0.0),
        xy + (reach, 0.0),
        tolerance_px=np.full(len(b), reach),
        max_distance=config.tracking.max_hamming,
        ratio=_RATIO,
    )
    rows = np.flatnonzero(matched >= 0)
    only = np.zeros(len(rows), dtype=np.int64)
    found = align_between(
        left.image[None],
        only,
        xy[rows],
        None,
        right.image[None],
        only,
        b.xy[matched[rows]].astype(np.float64),
        half_px=config.tracking.patch_half_px,
    )
    good = found.converged & (found.score >= config.tracking.min_patch_score)
    return xy[rows[good]], found.xy[good]


def _is_worth_it(fitted: FittedRows, rig: WorkingRig) -> bool:
    """Whether errors at the corners of the image are large and surely there."""
    x, y = _corners(rig)
    sure = np.abs(fitted.errors.rows_px(x, y)) > _SURE * sigma_of_rows(fitted, x, y)
    without_skew = fitted.errors._replace(skew_px=0.0)
    along = np.maximum(np.abs(without_skew.rows_px(x, y)), np.abs(without_skew.columns_px(x, y)))
    across = np.abs(fitted.errors.rows_px(x, y))
    return bool((sure & ((along > _WORTH_PX) | (across > _WORTH_WITH_SKEW_PX))).any())


def _largest_change(one: RowErrors, other: RowErrors, rig: WorkingRig) -> float:
    """By how many pixels two corrections differ at the corners of the image, at most."""
    x, y = _corners(rig)
    rows = one.rows_px(x, y) - other.rows_px(x, y)
    columns = one.columns_px(x, y) - other.columns_px(x, y)
    return float(max(np.abs(rows).max(), np.abs(columns).max()))


def right_camera(corrected: RowErrors, rig: WorkingRig) -> RightCamera | None:
    """The same in words of the right camera, and how it looks sideways, if that is known."""
    yaw_px = -rig.disparity_offset_px if rig.offset_is_yaw else 0.0
    if corrected == RowErrors() and yaw_px == 0.0:
        return None
    return RightCamera(
        pitch_deg=float(np.rad2deg(corrected.pitch_px / rig.fx)),
        yaw_deg=float(np.rad2deg(yaw_px / rig.fx)),
        roll_deg=float(np.rad2deg(corrected.roll_px / rig.fx)),
        zoom_percent=100.0 * corrected.zoom_px / rig.fx,
        rows_px=float(np.abs(corrected.rows_px(*_corners(rig))).max()),
    )


def _corners(rig: WorkingRig) -> tuple[Floats, Floats]:
    """Those of the image, in pixels from the principal point over focal length."""
    u, v = np.array([(u, v) for u in (0, rig.width - 1) for v in (0, rig.height - 1)]).T
    return (u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy
