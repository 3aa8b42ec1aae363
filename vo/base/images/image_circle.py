"""The circle that a fisheye lens fills in a wider image, which is black around it."""

from __future__ import annotations

import numpy as np

from vo.base.types import Bytes, Camera

_STEP = 4  # of the pixels looked at; rings are twice as wide
_BLACK, _MAX_BRIGHT = 24, 0.02  # grey level, and ratio of brighter pixels, around the circle
_INSIDE, _MIN_BRIGHT = 0.9, 0.5  # radius where the image must not be black, ratio of its pixels
_MIN_AROUND = 0.02  # ratio of the image


def circle_mask(image: Bytes, camera: Camera) -> Bytes | None:
    """Mask (H, W), 0 outside of the circle; None if the image is not black around one."""
    v, u = np.ogrid[: camera.height, : camera.width]
    radius = np.hypot(u - camera.cx, v - camera.cy)
    ring = (radius[::_STEP, ::_STEP] / (2 * _STEP)).astype(np.int64).ravel()
    pixels = np.bincount(ring)
    is_bright = image[::_STEP, ::_STEP].ravel() > _BLACK
    bright = np.bincount(ring, is_bright) / np.maximum(pixels, 1)
    lit = np.flatnonzero(bright > _MAX_BRIGHT)
    if len(lit) == 0 or pixels[lit[-1] + 1 :].sum() < _MIN_AROUND * pixels.sum():
        return None
    if bright[int(_INSIDE * lit[-1])] < _MIN_BRIGHT:
        return None
    return np.where(radius < 2 * _STEP * (lit[-1] + 1), np.uint8(255), np.uint8(0))
