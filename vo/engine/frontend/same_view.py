"""Comparison of the recorded images of a pair: are both from the same camera?"""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.geometry.quantiles import percentiles
from vo.base.types import Bytes, Floats32

_STEP = 8  # for a first look
_MIN_SIGMA = 5.0  # grey levels; images with less contrast are not compared
_MIN_CORRELATION = 0.9  # of grey levels, and of details
_DETAIL_PX = 2.0
_CORNERS, _MIN_CORNERS = 200, 50
# Displacement of nine in ten corners. The images of two cameras with a far scene differ by more:
# their lenses and mounts are never the same to this accuracy.
_MAX_SHIFT_PX = 0.05


def is_same_view(left: Bytes, right: Bytes) -> bool | None:
    """Whether two recorded images (H, W) agree pixel by pixel, but for noise and compression.

    None if they have too little contrast to tell.
    """
    if left.shape != right.shape:
        return False
    a, b = (image[::_STEP, ::_STEP].astype(np.float32) for image in (left, right))
    if min(a.std(), b.std()) < _MIN_SIGMA:
        return None
    if _correlation(a, b) < _MIN_CORRELATION:
        return False
    if np.array_equal(left, right):
        return True
    return _correlation(_details(left), _details(right)) >= _MIN_CORRELATION and _is_aligned(
        left, right
    )


def _is_aligned(left: Bytes, right: Bytes) -> bool:
    corners = cv2.goodFeaturesToTrack(left, _CORNERS, 0.01, 10.0)
    if corners is None or len(corners) < _MIN_CORNERS:
        return False
    moved, good, _ = cv2.calcOpticalFlowPyrLK(left, right, corners, corners.copy())
    shift = np.abs(moved - corners).max(axis=(1, 2))[good.ravel() > 0]
    return len(shift) >= _MIN_CORNERS and percentiles(shift, (90,))[0] < _MAX_SHIFT_PX


def _details(image: Bytes) -> Floats32:
    grey = image.astype(np.float32)
    return np.asarray(grey - cv2.GaussianBlur(grey, None, _DETAIL_PX), dtype=np.float32)


def _correlation(a: Floats32, b: Floats32) -> float:
    x, y = a - a.mean(), b - b.mean()
    scale = float(np.linalg.norm(x) * np.linalg.norm(y))
    return float(np.vdot(x, y)) / scale if scale > 0.0 else 0.0
