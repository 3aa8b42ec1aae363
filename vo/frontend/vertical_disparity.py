"""Brings the rows of pairs in line before features are looked for on the right.

A camera that was bumped since it was calibrated has rows that are pixels off, too far for matching
along rows, and disparities that err from place to place, which costs several per cent of the scale
before anything looks wrong. Rows tell most of it: they are corrected, and what follows from them
for disparities with them. What they cannot tell, a constant error of all disparities, is left to
`vo.refinement.disparity_bias`.

Source: Hansen et al., "Online Continuous Stereo Extrinsic Parameter Estimation", CVPR 2012 (the
right camera's angles from rows).
"""

from __future__ import annotations

from copy import deepcopy
from typing import NamedTuple

import numpy as np

from vo.config import Config
from vo.frontend.alignment import align_between
from vo.frontend.matching import match_segments
from vo.geometry.rectification import RectifiedRig
from vo.geometry.right_camera_error import is_worth_correcting, largest_change
from vo.geometry.vertical_disparity_model import VerticalDisparity, VerticalDisparityFit
from vo.types import Bytes, Floats, Keypoints

_FARTHEST = 0.06  # rows are looked for within this share of the image's height
_FEWEST = 100  # points that must agree, and
_LEAST_SHARE = 0.5  # of all that were matched
_RATIO = 0.8
_MOST_PAIRS = 30  # that are asked before it is given up if none tells
_LEAST_CHANGE_PX = 0.05


class View(NamedTuple):
    """A working image and its features."""

    image: Bytes
    keypoints: Keypoints


class VerticalDisparityCorrection:
    """Learns from pairs, ever more seldom, and corrects those that follow.

    The first pair that tells is corrected at once; pairs number 3, 7, 15, 31 … make it more exact:
    what one scene leaves open another one shows.

    Attributes:
        found: what pairs said until now, if one has told.
        corrected: what is corrected of that.
    """

    def __init__(self, config: Config) -> None:
        self.found: VerticalDisparity | None = None
        self.corrected = VerticalDisparity()
        self._config = config
        self._fit = VerticalDisparityFit()
        self._aligned: RectifiedRig | None = None
        self._pairs = 0
        self._next = 0

    def asks(self) -> bool:
        """Whether the next pair is to be learned from; to be called for every pair, once."""
        self._pairs += 1
        is_over = self.found is None and self._pairs > _MOST_PAIRS
        return self._config.stereo.row_correction and self._pairs > self._next and not is_over

    def learn(self, left: View, right: View, rig: RectifiedRig) -> bool:
        """Take in a pair, as it is corrected now; whether the correction has changed."""
        tells = self._take_in(left, right, rig)
        if tells or self.found is not None:  # also in the dark, a pair is asked but now and then
            self._next = 2 * self._pairs
        if not tells:
            return False
        fitted = self._fit.result()
        self.found = fitted.errors
        corrects = self._aligned is not None or is_worth_correcting(fitted, rig)
        wanted = fitted.errors if corrects else VerticalDisparity()
        if largest_change(self.corrected, wanted, rig) < _LEAST_CHANGE_PX:
            return False
        self.corrected = wanted
        self._aligned = rig.with_right_corrected(wanted)
        return True

    def aligned(self, rig: RectifiedRig) -> RectifiedRig:
        """The rig with its right images corrected, if there is something to correct."""
        return rig if self._aligned is None else self._aligned

    def _take_in(self, left: View, right: View, rig: RectifiedRig) -> bool:
        """Learn from a pair, if it tells."""
        xy, found = _matched(left, right, self._config)
        if len(xy) < _FEWEST:
            return False
        centre, focal = (rig.cx, rig.cy), (rig.fx, rig.fy)
        x, y = ((np.column_stack([found[:, 0], xy[:, 1]]) - centre) / focal).T
        rows_px = found[:, 1] - xy[:, 1] + self.corrected.vertical_px(x, y)
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
