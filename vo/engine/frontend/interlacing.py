"""Detection of interlaced images, whose odd and even rows were taken at different times.

Where something moves, neighbouring rows then show its edges at two places in turn: "combs".
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from vo.base.faults import Fault, FaultKind
from vo.base.types import Bytes

_STEP = 8  # every eighth column (row) is enough
_EXAMINED = 4  # every fourth frame, so that film with pulldown (2 frames of 5) is seen as well
_RECENT, _NEEDED = 5, 2  # examined frames, and how many of them need to have combs
_MIN_CONTRAST = 8  # grey levels between the two fields
# Share of pixels in combs from which an image is interlaced, and its smallest ratio to that of
# patterns which are no combs: noise and fine texture alternate as much from column to column or
# within a field. Clean images, with noise up to 40 grey levels, reach a share of 0.0004 more than
# 3 times that of patterns; interlaced ones in motion have medians of 0.015 to 0.28 more.
_MIN_SHARE = 0.005
_MIN_RATIO = 3.0


class InterlacingDetector:
    """Looks for combs in some of the images of camera 0, as recorded."""

    def __init__(self) -> None:
        self._images = 0
        self._recent: deque[float] = deque(maxlen=_RECENT)

    def update(self, image: Bytes) -> None:
        """Examine the next image (H, W), or pass over it."""
        if self._images % _EXAMINED == 0:
            self._recent.append(share_of_combs(image))
        self._images += 1

    @property
    def faults(self) -> tuple[Fault, ...]:
        """That the images are interlaced, if they are: nothing is done about it."""
        if sum(share > 0 for share in self._recent) < _NEEDED:
            return ()
        return (Fault(FaultKind.INTERLACED_IMAGES, value=max(self._recent)),)


def share_of_combs(image: Bytes) -> float:
    """Share of the pixels of an (H, W) image in combs of an interlaced one, 0 if it is not."""
    columns = np.ascontiguousarray(image[:, _STEP // 2 :: _STEP]).astype(np.int16)
    combs = _alternating(columns)
    if combs <= _MIN_SHARE:
        return 0.0
    rows = np.ascontiguousarray(image[_STEP // 2 :: _STEP].T).astype(np.int16)
    patterns = max(_alternating(columns[::2]), _alternating(rows))
    return combs if combs > _MIN_SHARE + _MIN_RATIO * patterns else 0.0


def _alternating(grey: NDArray[np.int16]) -> float:
    """Share of pixels of (N, M) whose neighbours in the first axis are alternately light and dark.

    Five in a row: each of the middle three differs from both of its neighbours in the same
    direction, and by more than twice as much as they differ from each other.
    """
    if len(grey) < 5 or grey.shape[1] == 0:
        return 0.0
    step = grey[1:] - grey[:-1]
    contrast = np.abs(step)
    least = np.maximum(2 * np.abs(grey[2:] - grey[:-2]), _MIN_CONTRAST)
    is_extreme = (step[1:] > 0) != (step[:-1] > 0)
    is_extreme &= np.minimum(contrast[1:], contrast[:-1]) > least
    return float((is_extreme[2:] & is_extreme[1:-1] & is_extreme[:-2]).mean())
