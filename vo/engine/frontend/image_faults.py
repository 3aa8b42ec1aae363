"""Faults of recordings that some of their images show: few pixels, interlaced rows, or blur.

Where something moves, neighbouring rows of interlaced images show its edges at two places in turn,
"combs", as their odd and even rows were taken at different times.
"""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np

from vo.base.failures import ImageDefect
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.quantiles import percentiles
from vo.base.types import Bytes
from vo.engine.frontend.contrast import noise_level

# Errors grow with the angle of a pixel, and with fewer features. The shared clips at 25 to 35 % of
# their size, 15,000 to 56,000 pixels, have 5 to 28 times the error; at half of it, 64,000 pixels,
# up to 3 times.
SMALL_PIXELS = 60_000
# Clean recordings, with the motion blur of handheld cameras, have at most 0.40; box filters of 21
# pixels 0.7 to 0.8, with four times the error of the path.
MAX_BLUR = 0.6
# Every fourth frame is examined for combs, so that film with pulldown (2 frames of 5) is seen as
# well, and every sixteenth for blur; how many of the newest of them need to show it.
_COMBS_EVERY, _COMBS_RECENT, _BLUR_EVERY, _BLUR_RECENT, _NEEDED = 4, 5, 16, 3, 2
_STEP = 8  # every eighth column (row) is enough for combs
_MIN_CONTRAST = 8  # grey levels between the two fields
# Share of pixels in combs from which an image is interlaced, and its smallest ratio to that of
# patterns which are no combs: noise and fine texture alternate as much from column to column or
# within a field. Clean images, with noise up to 40 grey levels, reach a share of 0.0004 more than
# 3 times that of patterns; interlaced ones in motion have medians of 0.015 to 0.28 more.
_MIN_SHARE = 0.005
_MIN_RATIO = 3.0


class ImageFaults:
    """Examines some of the images of camera 0; nothing is done about what it finds."""

    def __init__(self) -> None:
        self._images = 0
        self._combs: deque[float] = deque(maxlen=_COMBS_RECENT)
        self._blur: deque[float] = deque(maxlen=_BLUR_RECENT)

    def update(self, image: Bytes) -> None:
        """Examine the next image (H, W) as recorded, or pass over it."""
        if self._images % _COMBS_EVERY == 0:
            self._combs.append(share_of_combs(image))
        if self._images % _BLUR_EVERY == 0:
            quarter = image.shape[0] // 4  # the middle half of the rows is enough
            self._blur.append(blur(image[quarter : image.shape[0] - quarter]))
        self._images += 1

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What the newest of them show."""
        found = []
        if sum(share > 0 for share in self._combs) >= _NEEDED:
            found.append(Fault(FaultKind.INTERLACED_IMAGES, value=max(self._combs)))
        # An image of one grey has a blur of 1, and no blur that could be measured.
        if sum(MAX_BLUR < value < 1.0 for value in self._blur) >= _NEEDED:
            found.append(Fault(FaultKind.BLURRED_IMAGES, value=max(self._blur)))
        return tuple(found)


def size_faults(pixels: int) -> tuple[Fault, ...]:
    """The fault of images with so few pixels that the path is inaccurate; in thousands."""
    if pixels >= SMALL_PIXELS:
        return ()
    return (Fault(FaultKind.SMALL_IMAGES, value=1e-3 * pixels),)


def share_of_combs(image: Bytes) -> float:
    """Share of the pixels of an (H, W) image in combs of an interlaced one, 0 if it is not."""
    columns = np.ascontiguousarray(image[:, _STEP // 2 :: _STEP])
    combs = _alternating(columns)
    if combs <= _MIN_SHARE:
        return 0.0
    rows = np.ascontiguousarray(image[_STEP // 2 :: _STEP].T)
    patterns = max(_alternating(columns[::2]), _alternating(rows))
    return combs if combs > _MIN_SHARE + _MIN_RATIO * patterns else 0.0


def _alternating(grey: Bytes) -> float:
    """Share of pixels of (N, M) whose neighbours in the first axis are alternately light and dark.

    Five in a row: each of the middle three differs from both of its neighbours in the same
    direction, and by more than twice as much as they differ from each other.
    """
    if len(grey) < 5 or grey.shape[1] == 0:
        return 0.0
    contrast, other = cv2.absdiff(grey[1:], grey[:-1]), cv2.absdiff(grey[2:], grey[:-2])
    least, is_up = cv2.min(contrast[1:], contrast[:-1]), grey[1:] > grey[:-1]
    is_extreme = (is_up[1:] != is_up[:-1]) & (least > _MIN_CONTRAST)
    is_extreme &= cv2.subtract(least, other) > other  # a byte: at least 0, which is no more
    return float((is_extreme[2:] & is_extreme[1:-1] & is_extreme[:-2]).mean())


def blur(image: Bytes) -> float:
    """No-reference blur measure of an (H, W) image: 0 is sharp, 1 has no detail.

    Source: Crété et al., "The blur effect", SPIE 2007.
    """
    if min(image.shape) < 2:
        return 1.0
    small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    grey = np.asarray(small, dtype=np.float32)
    worst = 0.0
    for axis, kernel in ((0, (1, 9)), (1, (9, 1))):
        detail = np.abs(np.diff(grey, axis=axis))
        kept = np.abs(np.diff(cv2.blur(grey, kernel), axis=axis))
        total = float(detail.sum())
        lost = float(np.maximum(detail - kept, 0.0).sum())
        worst = max(worst, (total - lost) / total if total > 0 else 1.0)
    return worst


_SAMPLE = 4  # every fourth pixel of every fourth row is enough for percentiles
_BLACK, _WHITE = 16, 250
_MIN_RANGE = 6  # grey levels; the noise of a sensor alone has about as many

# Limits of defects that are named only where tracking has failed. Well exposed, sharp recordings
# have: 95th percentile above 175, range above 130, blur below 0.4, noise below 3 grey levels.
_DARK = 60
_LOW_RANGE = 30
_NOISY = 15.0


def missing_content(image: Bytes) -> ImageDefect | None:
    """Why an (H, W) uint8 image has no content: black, white, or of one grey; else None."""
    low, middle, high = percentiles(image[::_SAMPLE, ::_SAMPLE], (5, 50, 95))
    if high < _BLACK:
        return ImageDefect.BLACK
    if middle > _WHITE:
        return ImageDefect.WHITE
    return ImageDefect.ONE_GREY if high - low < _MIN_RANGE else None


def image_defect(image: Bytes) -> ImageDefect | None:
    """The first defect of an (H, W) uint8 image that makes features rare or unstable, or None."""
    low, high = percentiles(image[::_SAMPLE, ::_SAMPLE], (5, 95))
    if image.size < SMALL_PIXELS:
        return ImageDefect.SMALL
    if high < _DARK:
        return ImageDefect.DARK
    if high - low < _LOW_RANGE:
        return ImageDefect.LOW_CONTRAST
    if share_of_combs(image) > 0:
        return ImageDefect.INTERLACED
    if noise_level(image) > _NOISY:
        return ImageDefect.NOISY
    return ImageDefect.BLURRED if blur(image) > MAX_BLUR else None
