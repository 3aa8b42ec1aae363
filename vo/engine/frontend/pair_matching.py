"""Matching of the features of a rectified pair across rows, before rows are known to agree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Bytes, Floats, Keypoints
from vo.engine.frontend.contracts import EpipolarSegments, Matcher, feature_set
from vo.engine.frontend.patch_alignment import PatchAligner, patches_of

_MAX_OFFSET_RATIO = 0.06  # search range across rows, ratio of the image height
_RATIO = 0.8  # ratio test; stricter than in tracking, as the search range is wide


class View(NamedTuple):
    """A rectified image and its features."""

    image: Bytes
    keypoints: Keypoints


class PairPoints(NamedTuple):
    """The same points in both images of a pair; rows belong together.

    Attributes:
        left: (N, 2) pixels in the left image.
        right: (N, 2) pixels in the right image, to sub-pixel.
    """

    left: Floats
    right: Floats

    @property
    def disparity(self) -> Floats:
        """(N,) pixels."""
        return np.asarray(self.left[:, 0] - self.right[:, 0])

    @property
    def rows_px(self) -> Floats:
        """(N,) row in the right image minus row in the left."""
        return np.asarray(self.right[:, 1] - self.left[:, 1])

    def select(self, mask: Bools) -> PairPoints:
        """Some of the points."""
        return PairPoints(self.left[mask], self.right[mask])


class PairMatcher(NamedTuple):
    """Matches features of pairs whose rows may differ by several pixels.

    Attributes:
        max_disparity_ratio: maximum disparity, ratio of the image width.
    """

    matcher: Matcher
    patches: PatchAligner
    max_disparity_ratio: float

    def match(self, left: View, right: View, *, both_ways: bool = False) -> PairPoints:
        """Points of a pair.

        Args:
            left: the left image.
            right: the right image.
            both_ways: whether disparities may be negative as well; else by the search range across
                rows only.
        """
        height, width = left.image.shape
        xy = left.keypoints.xy.astype(np.float64)
        reach = _MAX_OFFSET_RATIO * height
        farthest = self.max_disparity_ratio * width
        region = EpipolarSegments(
            xy - (farthest, 0.0),
            xy + (farthest if both_ways else reach, 0.0),
            np.full(len(right.keypoints), reach),
        )
        matches = self.matcher.match(
            feature_set(left.keypoints),
            feature_set(right.keypoints),
            region,
            ratio=_RATIO,
            check_rotation=False,
        )
        start = right.keypoints.xy[matches.train].astype(np.float64)
        patches = patches_of(left.image, xy[matches.query])
        found = self.patches.align(patches, right.image, start)
        good = self.patches.is_found(found)
        return PairPoints(xy[matches.query[good]], found.xy[good])


# Own bodies, bonnets and dirt are near; text that is written into both images has no disparity.
# What is clearly visible in both images and far away is the scene of a camera that stands.
_MIN_DEPTH_M = 4.0  # bonnets end at 3 m
_MIN_DISPARITY_PX = 1.0  # that of text is 0
_MIN_POINTS, _MIN_RATIO = 20, 0.5


def is_scene(fixed: Bools, points: PairPoints | None, baseline_px: float) -> bool:
    """Whether content that does not move is farther away than anything mounted on the camera.

    Args:
        fixed: (H/2, W/2) where it is, in the left image at half its size.
        points: of a pair of images, with disparities; None without any.
        baseline_px: disparity at one metre.
    """
    if points is None or len(points.left) < _MIN_POINTS:
        return False
    u, v = (0.5 * points.left).astype(np.int64).T
    inside = (u < fixed.shape[1]) & (v < fixed.shape[0])
    disparity = points.disparity[inside][fixed[v[inside], u[inside]]]
    is_far = (disparity > _MIN_DISPARITY_PX) & (disparity < baseline_px / _MIN_DEPTH_M)
    return len(disparity) >= _MIN_POINTS and float(is_far.mean()) > _MIN_RATIO
