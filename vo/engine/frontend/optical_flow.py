"""Optical flow of points: pyramidal Lucas-Kanade with a forward-backward check."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.types import Bools, Bytes, Floats, Floats32

_WINDOW_PX = 21
_LEVELS = 3  # smaller images besides the full one
_STEPS, _STEP_PX = 30, 0.01
_MIN_EIGENVALUE = 1e-4  # of the window's gradient matrix, per pixel; flatter windows are lost
_MAX_RETURN_PX = 0.7  # between a point and where the way there and back leads


class Flow(NamedTuple):
    """Points in a second image.

    Attributes:
        xy: (N, 2) pixels there.
        found: (N,) whether they were found, and lead back to where they came from.
    """

    xy: Floats
    found: Bools


def follow(before: Bytes, after: Bytes, xy: Floats | Floats32, start_xy: Floats) -> Flow:
    """Find points of one image in another of the same size.

    Sources: Lucas and Kanade, "An iterative image registration technique", IJCAI 1981; Bouguet,
    "Pyramidal implementation of the Lucas Kanade feature tracker", 2001; Kalal et al.,
    "Forward-backward error", ICPR 2010.

    Args:
        before: (H, W) uint8.
        after: (H, W) uint8.
        xy: (N, 2) pixels in `before`.
        start_xy: (N, 2) pixels in `after` to start from.
    """
    if len(xy) == 0:
        return Flow(np.empty((0, 2)), np.empty(0, dtype=bool))
    first = np.ascontiguousarray(xy, dtype=np.float32)
    there, is_there = _lucas_kanade(before, after, first, start_xy.astype(np.float32))
    back, is_back = _lucas_kanade(after, before, there, first.copy())
    returns = np.hypot(*(back - first).T) <= _MAX_RETURN_PX
    size = np.array(after.shape[::-1])
    inside = ((there >= 0) & (there <= size - 1)).all(axis=1)
    return Flow(there.astype(np.float64), is_there & is_back & returns & inside)


def _lucas_kanade(
    before: Bytes, after: Bytes, xy: Floats32, start_xy: Floats32
) -> tuple[Floats32, Bools]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        xy.reshape(-1, 1, 2),
        start_xy.reshape(-1, 1, 2).copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=_LEVELS,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, _STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=_MIN_EIGENVALUE,
    )
    return found.reshape(-1, 2), status.ravel() == 1
