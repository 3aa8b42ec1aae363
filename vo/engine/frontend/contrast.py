"""Contrast of dark and hazy images, raised before anything is searched in them."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.quantiles import median, percentiles
from vo.base.types import Bytes, Floats32

_STEP = 8  # every eighth pixel of every eighth row is enough for percentiles
_ENDS = (0.05, 0.95)
_MIN_RANGE = 64.0  # grey levels between the ends; images with more stay as they are
_RAISED_RANGE = 120.0  # that of rooms in good light; with 64, fog had twice the error
_MIN_CONTENT = 3.0  # grey levels between the ends of means of 8 x 8 pixels: more than noise
_NEWEST_SHARE = 0.2  # of the smoothed range
_MIDDLE = 110.0
_NOISE_FILTER = cv2.getGaussianKernel(7, 1.0, cv2.CV_32F)

_EXAMINED = 8  # every eighth raised image is compared with its noise
_RECENT, _NEEDED = 5, 4  # examined images, and how many of them need to be faint
_ROUNDING = 12**-0.5  # standard deviation of rounding to grey levels
_CELL = 20  # pixels; each has its strongest edge
_MIN_STRENGTH = 1.3
"""Edge of a good cell (grey levels per pixel) over the noise of a pixel, both as recorded. Noise
alone has 0.8; fog with ten times the error of the path 0.9 to 1.3; dark images with twice the error
of bright ones 1.2 to 3; clean recordings have more than 8."""


class ContrastCorrection:
    """Spreads the grey levels of images that use few of them, and filters their noise.

    Thresholds of corners and pixels of 8 bits suit images in good light. Both cameras are treated
    alike, and the range changes slowly, so that images remain comparable.
    """

    def __init__(self) -> None:
        self._middle, self._range = 0.0, 0.0
        self._raised = 0
        self._strengths: deque[float] = deque(maxlen=_RECENT)

    def update(self, images: tuple[Bytes | None, ...]) -> tuple[Bytes | None, ...]:
        """The next images (H, W) uint8 of all cameras, with more contrast if they have little."""
        first = images[0]
        assert first is not None
        low, high = _ends(first, _STEP)
        if high - low >= _MIN_RANGE or has_content(first):
            share = _NEWEST_SHARE if self._range else 1.0
            self._middle += share * ((low + high) / 2.0 - self._middle)
            self._range += share * (high - low - self._range)
        if not 0.0 < self._range < _MIN_RANGE:
            self._strengths.clear()
            return images
        return tuple(i if i is None or self._is_kept(i) else self._raise(i) for i in images)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """That edges are little stronger than noise, if they are: nothing is done about it."""
        if sum(strength < _MIN_STRENGTH for strength in self._strengths) < _NEEDED:
            return ()
        return (Fault(FaultKind.FAINT_IMAGES, value=min(self._strengths)),)

    def _is_kept(self, image: Bytes) -> bool:
        """Whether an image shows noise alone, or is clear while the left lens is fogged."""
        low, high = _ends(image, _STEP)
        return high - low >= max(_MIN_RANGE, 2.0 * self._range) or not has_content(image)

    def _raise(self, image: Bytes) -> Bytes:
        gain = _RAISED_RANGE / self._range
        offset = _MIDDLE - gain * self._middle
        raised = np.asarray(
            cv2.sepFilter2D(image, cv2.CV_32F, _NOISE_FILTER, _NOISE_FILTER * gain, delta=offset),
            np.float32,
        )
        if self._raised % _EXAMINED == 0:
            self._strengths.append(
                _edge_strength(raised) / (gain * max(noise_level(image), _ROUNDING))
            )
        self._raised += 1
        return np.asarray(np.clip(raised, 0.0, 255.0).round(), np.uint8)


def noise_level(image: Bytes) -> float:
    """Standard deviation of the noise of an (H, W) image in grey levels.

    The median makes it robust to edges. Source: Immerkær, "Fast noise variance estimation", CVIU
    1996 (the mask).
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = np.abs(cv2.filter2D(image, cv2.CV_32F, mask))
    return median(response[::4, ::4]) / (0.6745 * 6.0)


def _edge_strength(image: Floats32) -> float:
    """Largest gradient of a cell that is better than nine tenths of the cells of an image."""
    across = (image[1:-1, 2:] - image[1:-1, :-2]) / 2.0
    down = (image[2:, 1:-1] - image[:-2, 1:-1]) / 2.0
    gradient = np.hypot(across, down)
    strongest = cv2.dilate(gradient, np.ones((_CELL, _CELL), np.uint8))[::_CELL, ::_CELL]
    return percentiles(np.asarray(strongest), (90,))[0]


def has_content(image: Bytes) -> bool:
    """Whether an image shows more than noise."""
    size = max(image.shape[1] // _STEP, 1), max(image.shape[0] // _STEP, 1)
    means = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    low, high = _ends(np.asarray(means, np.uint8), 1)
    return bool(high - low > _MIN_CONTENT)


@compiled
def _ends(image, step):  # type: ignore[no-untyped-def]
    """Grey levels between which all pixels lie but for 5 % at either end.

    Of every `step`th pixel of every `step`th row.
    """
    counts, pixels = np.zeros(256, dtype=np.int64), 0
    for v in range(0, image.shape[0], step):
        for u in range(0, image.shape[1], step):
            counts[image[v, u]] += 1
            pixels += 1
    low = high = below = 0
    for grey in range(256):
        below += counts[grey]
        low += below < _ENDS[0] * pixels
        high += below < _ENDS[1] * pixels
    return float(low), float(high)
