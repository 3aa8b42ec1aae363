"""Depth of what does not move in the image: a scene, or something that is mounted on the camera.

Own bodies, bonnets and dirt are near; text that is written into both images has no disparity. What
is clearly visible in both images and far away is the scene of a camera that stands.
"""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools
from vo.engine.frontend.pair_matching import PairPoints

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
