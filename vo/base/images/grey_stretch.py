"""Conversion of 16-bit images to 8 bits where the images to come are unknown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo.base.types import Bytes

Pixels = NDArray[np.unsignedinteger]

_PERCENTILES = (1.0, 99.0)
_PIXEL_STEP = 4
_MARGIN = 0.1  # of the range between the percentiles, at either end
_MIN_COUNTS = 200.0  # of the range; noise of a dark or covered sensor is not amplified
_WEIGHT = 0.02  # of a new image: the range follows the light in about two seconds


class RunningStretch:
    """Spreads the range of pixel values that images use over 8 bits.

    The range is a running mean, so that brightness changes slowly, the same for all cameras. A
    recording is converted with its own range instead, which is known beforehand.
    """

    def __init__(self) -> None:
        self._middle = self._half = 0.0
        self._has_range = False

    def update(self, image: Pixels) -> None:
        """Take the newest image of camera 0, (H, W) uint16, into account."""
        low, high = np.percentile(image[::_PIXEL_STEP, ::_PIXEL_STEP], _PERCENTILES).tolist()
        middle = (low + high) / 2.0
        half = max((high - low) * (0.5 + _MARGIN), _MIN_COUNTS / 2.0)
        weight = _WEIGHT if self._has_range else 1.0
        self._middle += weight * (middle - self._middle)
        self._half += weight * (half - self._half)
        self._has_range = True

    def to_8_bits(self, image: Pixels) -> Bytes:
        """(H, W) uint8 grey levels of a (H, W) uint16 image of any camera."""
        if not self._has_range:  # camera 0 has given no image yet
            self.update(image)
        values = np.arange(2**16, dtype=np.float64) - (self._middle - self._half)
        table = np.clip(values * (127.5 / self._half) + 0.5, 0.0, 255.0).astype(np.uint8)
        return np.asarray(table[image], dtype=np.uint8)
