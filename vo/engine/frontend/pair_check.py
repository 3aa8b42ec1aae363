"""Check of the first pairs: whether left and right are what the calibration takes them for.

Images that are exchanged, mirrored or turned by 180 degrees, and one camera recorded twice, give
wrong matches, and from those a path that looks sound. Such recordings are refused.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.quantiles import percentiles
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import VerticalDisparityFit
from vo.base.types import Bytes, Floats, Frame
from vo.engine.frontend.contracts import FeatureExtractor
from vo.engine.frontend.pair_matching import PairMatcher, PairPoints, View
from vo.engine.frontend.same_view import is_same_view

_MIN_POINTS = 100  # minimum points with consistent rows, and
_MIN_RATIO = 0.5  # minimum ratio of them to all matches
_MIN_FEATURES = 300  # of an image in which points should be found
# Disparities are clearly positive or negative from here on. A right camera that was turned since
# its calibration makes those of far points negative, by a few pixels.
_CLEAR_PX = 3.0
_MIN_CLEAR = 50
_MAX_OTHER_RATIO = 0.05  # of clear disparities with the other sign
# Of the disparities of exchanged images a tenth is below both, and a twentieth at most above zero,
# where far points are; a camera that was turned by that much leaves those of near points positive.
_EXCHANGED_PX, _EXCHANGED_DEG = -5.0, -0.6
_ZERO_PX = 2.0
_MIN_GAIN = 3.0  # of points by mirroring or turning the right image
_MAX_TURN_CHECKS = 3  # each takes three extractions of features
_SAME_PAIRS = 3  # a driver may repeat one image
_MAX_PAIRS = 30  # pairs without a result after which checks are given up

TURNS = {
    "turned by 180°": -1,
    "mirrored left to right": 1,
    "mirrored top to bottom": 0,
}
"""What may have happened to an image, and the code of `cv2.flip` that reverts it."""


class Signs(NamedTuple):
    """Signs of disparities that are clear.

    Attributes:
        is_positive: whether they are positive, as they should be.
        are_exchanged: whether they are negative, and too large for a slightly turned camera.
    """

    is_positive: bool
    are_exchanged: bool


def disparity_signs(disparity: Floats, fx: float) -> Signs:
    """Signs of the disparities (N,) of matched points."""
    clear = np.abs(disparity) > _CLEAR_PX
    count, positive = int(clear.sum()), int((disparity[clear] > 0).sum())
    if count < _MIN_CLEAR:
        return Signs(is_positive=False, are_exchanged=False)
    limit = min(_EXCHANGED_PX, float(fx * np.tan(np.deg2rad(_EXCHANGED_DEG))))
    low, high = percentiles(disparity, (10, 100.0 * (1.0 - _MAX_OTHER_RATIO)))
    is_negative = positive <= _MAX_OTHER_RATIO * count and high < _ZERO_PX
    return Signs(positive >= (1.0 - _MAX_OTHER_RATIO) * count, is_negative and low < limit)


class PairCheck:
    """Checks pairs until their arrangement is certain, which most often takes one."""

    def __init__(
        self, rig: RectifiedRig, extractor: FeatureExtractor, matcher: PairMatcher
    ) -> None:
        self._rig = rig
        self._extractor = extractor
        self._matcher = matcher
        self._is_arranged = False  # disparities are positive
        self._is_different = False  # images are of two cameras
        self._pairs = 0
        self._same = 0
        self._turn_checks = 0

    def needs_next_pair(self) -> bool:
        """Whether `update` should get the next pair; to be called once for every pair."""
        self._pairs += 1
        is_due = self._pairs & (self._pairs - 1) == 0  # pairs 1, 2, 4, 8, 16
        return is_due and not self._is_arranged and self._pairs <= _MAX_PAIRS

    def compare(self, frame: Frame) -> None:
        """Compare the recorded images of a pair.

        Raises:
            SourceError: both are of the same camera.
        """
        if self._is_different or frame.image1 is None or self._pairs > _MAX_PAIRS:
            return
        is_same = is_same_view(frame.image0, frame.image1)
        if is_same is None:  # dark, for instance
            return
        self._same = self._same + 1 if is_same else 0
        self._is_different = not is_same
        if self._same >= _SAME_PAIRS:
            raise SourceError(
                f"left and right show the same image in {_SAME_PAIRS} frames, until frame "
                f"{frame.index}: the same camera twice? give the topics or folders of both "
                "cameras (`topics=left=… right=…`), or use `mode=mono`"
            )

    def update(self, index: int, left: View, right: View, points: PairPoints | None) -> None:
        """Check the signs of a pair's disparities.

        Args:
            index: number of the frame, for messages.
            left: the left image.
            right: the right image.
            points: points with consistent rows, if they are known: most with positive disparities.

        Raises:
            SourceError: the images are exchanged, mirrored or turned.
        """
        fx = self._rig.fx
        if self._is_arranged:
            return
        if points is not None and disparity_signs(points.disparity, fx).is_positive:
            self._is_arranged = True
            return
        points = self._consistent(left, right)
        signs = disparity_signs(points.disparity, fx)
        if signs.are_exchanged and len(points.left) >= _MIN_POINTS:
            raise SourceError(_exchanged(points, index))
        self._is_arranged = signs.is_positive and len(points.left) >= _MIN_POINTS
        enough = min(len(left.keypoints), len(right.keypoints)) >= _MIN_FEATURES
        if len(points.left) < _MIN_POINTS and enough and self._turn_checks < _MAX_TURN_CHECKS:
            self._turn_checks += 1
            self._check_turned(index, left, right, len(points.left))

    def are_exchanged(self, left: View, right: View) -> bool:
        """Whether the images of a pair have changed places, later in a recording."""
        points = self._consistent(left, right)
        signs = disparity_signs(points.disparity, self._rig.fx)
        return signs.are_exchanged and len(points.left) >= _MIN_POINTS

    def _check_turned(self, index: int, left: View, right: View, usual: int) -> None:
        """Whether the right image has to be mirrored or turned to match the left one."""
        for how, code in TURNS.items():
            image: Bytes = np.ascontiguousarray(cv2.flip(right.image, code), dtype=np.uint8)
            turned = View(image, self._extractor.extract(image))
            count = len(self._consistent(left, turned).left)
            if count >= max(_MIN_POINTS, _MIN_GAIN * usual):
                raise SourceError(
                    f"the right image is {how}, or the left one is ({count} points match if it is "
                    f"reverted, {usual} as recorded, frame {index}): revert it in the camera's "
                    "driver, or use `mode=mono`"
                )

    def _consistent(self, left: View, right: View) -> PairPoints:
        """Points of a pair, with disparities of any sign, whose rows agree with a smooth error.

        None if that is less than half of all matches.
        """
        points = self._matcher.match(left, right, both_ways=True)
        if len(points.left) < _MIN_POINTS:
            return points.select(np.zeros(len(points.left), dtype=bool))
        rig = self._rig
        x = (points.right[:, 0] - rig.cx) / rig.fx
        y = (points.left[:, 1] - rig.cy) / rig.fy
        inlier = VerticalDisparityFit().add(x, y, points.rows_px, points.disparity)
        if inlier.mean() < _MIN_RATIO:
            inlier[:] = False
        return points.select(inlier)


def _exchanged(points: PairPoints, index: int) -> str:
    ratio = float((points.disparity < 0).mean())
    return (
        f"left and right images are exchanged, or both are mirrored or turned by 180°: {ratio:.0%} "
        f"of {len(points.left)} points are farther right in the right image (frame {index}); "
        "exchange them (`topics=left=… right=…`, or the folders), turn them, or use "
        "`mode=mono`"
    )
