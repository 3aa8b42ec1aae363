"""Blur of images, and detection of recordings that are blurred throughout."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.types import Bytes

_EXAMINED = 16  # every sixteenth frame
_RECENT, _NEEDED = 3, 2  # examined frames, and how many of them need to be blurred
# Clean recordings, with the motion blur of handheld cameras, have at most 0.40; box filters of 21
# pixels 0.7 to 0.8, with four times the error of the path.
MAX_BLUR = 0.6


class BlurDetector:
    """Measures the blur of some of the images of camera 0."""

    def __init__(self) -> None:
        self._images = 0
        self._recent: deque[float] = deque(maxlen=_RECENT)

    def update(self, image: Bytes) -> None:
        """Examine the next image (H, W), or pass over it."""
        if self._images % _EXAMINED == 0:
            quarter = image.shape[0] // 4  # the middle half of the rows is enough
            self._recent.append(blur(image[quarter : image.shape[0] - quarter]))
        self._images += 1

    @property
    def faults(self) -> tuple[Fault, ...]:
        """That the images are blurred, if they are: nothing is done about it."""
        # An image of one grey has a blur of 1, and no blur that could be measured.
        if sum(MAX_BLUR < value < 1.0 for value in self._recent) < _NEEDED:
            return ()
        return (Fault(FaultKind.BLURRED_IMAGES, value=max(self._recent)),)


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
