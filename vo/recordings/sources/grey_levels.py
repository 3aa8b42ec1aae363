"""Conversion of the pixels of a recording to 8 bits, the same for all its cameras."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.frozen import frozen
from vo.base.types import Bytes, Floats
from vo.recordings.sources.images import Pixels, StoredImage, estimate_bit_depth

_MIN_LEVELS = 64.0
"""Of 256 levels; with 31 the path error of a rendered hall was twice as large, with 62 1.2 times,
with 8 there was no path."""

_PERCENTILES = (1.0, 99.0)
_MARGIN = 0.1  # of the range between the percentiles, at either end
_MIN_COUNTS = 200.0  # of a stretched range; noise of a dark or covered sensor is not amplified
_SAMPLES = 33
_ROUGH, _SMOOTHER = 0.5, 0.4
"""Roughness from which an image may be noise, and ratio that an exchange of bytes makes."""
_ALIKE = 0.8
"""Difference of pixels two apart to that of neighbours: below 0.8 in mosaics of filters, also with
balanced colours, 1.0 in noise, 1.1 to 1.7 in images of 60 recordings."""
_TENT = np.array([0.25, 0.5, 0.25])
_PIXEL_STEP = 4
_MIN_SPAN = 0.25
"""Of the median range. Images with less, such as those of a closed shutter, do not count."""


@frozen(eq=False)
class Stretch:
    """Range of pixel values that is spread over 8 bits, as it changes over a recording.

    Attributes:
        frames: (K,) numbers of the frames where it was measured, increasing.
        low: (K,) value that becomes 0.
        high: (K,) value that becomes 255.
    """

    frames: Floats
    low: Floats
    high: Floats

    def table(self, frame: int) -> Bytes:
        """(65536,) grey level of each pixel value; linear in time between the measurements."""
        low, high = (np.interp(frame, self.frames, ends) for ends in (self.low, self.high))
        levels = (np.arange(2**16, dtype=np.float64) - low) * (255.0 / (high - low))
        return np.asarray(np.clip(levels + 0.5, 0.0, 255.0), dtype=np.uint8)


@frozen(eq=False)
class GreyLevels:
    """Conversion to 8 bits.

    Attributes:
        bit_depth: number of bits that the camera uses; the upper 8 of these are kept.
        stretch: used instead, if the images use little of that range; else None.
        are_swapped: whether the two bytes of all values are stored in the wrong order.
        is_mosaic: whether pixels have alternating colour filters (Bayer) and are not converted.
    """

    bit_depth: int = 16
    stretch: Stretch | None = None
    are_swapped: bool = False
    is_mosaic: bool = False

    def to_8_bits(self, image: Pixels, frame: int) -> Bytes:
        """Convert an image of a frame; images of 8 bits stay as they are, but for mosaics."""
        if self.are_swapped and image.dtype == np.uint16:
            image = image.byteswap()
        if self.is_mosaic:
            # Each pixel gets a quarter of red and blue and half of green, in any arrangement.
            image = np.asarray(cv2.sepFilter2D(image, -1, _TENT, _TENT), dtype=image.dtype)
        if image.dtype == np.uint8:
            return np.asarray(image, dtype=np.uint8)
        if self.stretch is not None:
            return np.asarray(self.stretch.table(frame)[image], dtype=np.uint8)
        return np.asarray(np.minimum(image >> (self.bit_depth - 8), 255), dtype=np.uint8)


def find_grey_levels(
    left: Sequence[StoredImage], right: Sequence[StoredImage | None] | None = None
) -> GreyLevels:
    """The conversion for a recording, from images spread evenly over all of it.

    16-bit images whose values, but for 1 % at either end, lie within a quarter of the camera's
    range, as those of thermal cameras, are stretched. The stretch depends on the number of a frame
    only, neither on where reading begins nor on threads.
    """
    samples = _sample(left)
    swapped = bool(samples) and all(_is_swapped(image) for image in samples)
    if swapped:
        left = [_Swapped(image) for image in left]
        right = right and [None if image is None else _Swapped(image) for image in right]
        samples = [image.byteswap() for image in samples]
    mosaic = 2 * sum(seems_mosaic(image) for image in samples) > len(samples)
    bit_depth = estimate_bit_depth(left)
    stretch = None
    if bit_depth > 8:
        frames = sorted({round(i) for i in np.linspace(0, len(left) - 1, _SAMPLES).tolist()})
        if _is_narrow(left, frames[:: _SAMPLES // 4], bit_depth):
            stretch = _measure(left, right, frames)
    return GreyLevels(bit_depth, stretch, swapped, mosaic)


def _sample(images: Sequence[StoredImage]) -> list[Pixels]:
    """About three images, evenly spread, without unreadable ones."""
    samples = []
    for stored in images[:: max(1, len(images) // 3)]:
        try:
            samples.append(stored.read())
        except SourceError:
            continue
    return samples


@frozen()
class _Swapped:
    """An image of 16 bits whose bytes are exchanged."""

    image: StoredImage

    @property
    def name(self) -> str:
        return self.image.name

    def read(self, colour: bool = False) -> Pixels:
        return self.image.read(colour).byteswap()


def _is_swapped(image: Pixels) -> bool:
    """Whether neighbouring pixels differ much less after exchanging the bytes of their values."""
    if image.dtype != np.uint16:
        return False
    # Relative to the deviation, as an image of 8 bits may be in the upper byte only.
    rough, smooth = (difference(i) / max(i.std(), 1.0) for i in (image, image.byteswap()))
    return bool(rough > _ROUGH and smooth < _SMOOTHER * rough)


def seems_mosaic(image: Pixels) -> bool:
    """Whether pixels two apart are more alike than neighbours, along rows and columns."""
    grey = image if image.ndim == 2 else image[:, :, 0]
    return all(difference(each, 2) < _ALIKE * difference(each) for each in (grey, grey.T))


def difference(image: Pixels, columns: int = 1) -> float:
    """Mean difference of pixels so many columns apart."""
    after, before = image[:, columns:], image[:, :-columns]
    return cv2.norm(after, before, cv2.NORM_L1) / after.size if after.size else 0.0


def _is_narrow(images: Sequence[StoredImage], frames: Sequence[int], bit_depth: int) -> bool:
    ranges = [found for frame in frames if (found := _range_of([images[frame]])) is not None]
    if not ranges:
        return False
    span = max(high for _, high in ranges) - min(low for low, _ in ranges)
    return span < _MIN_LEVELS * 2.0 ** (bit_depth - 8)


def _measure(
    left: Sequence[StoredImage], right: Sequence[StoredImage | None] | None, frames: Sequence[int]
) -> Stretch | None:
    """The stretch from some frames; None if none can be read."""
    rows = []
    for frame in frames:
        images = [left[frame], None if right is None else right[frame]]
        found = _range_of([image for image in images if image is not None])
        if found is not None:
            rows.append((float(frame), *found))
    if not rows:
        return None
    measured = np.array(rows)
    spans = measured[:, 2] - measured[:, 1]
    measured = measured[spans >= _MIN_SPAN * np.median(spans)]
    frame_numbers, low, high = measured.T
    middle, span = (low + high) / 2.0, high - low
    half = np.maximum(span * (0.5 + _MARGIN), _MIN_COUNTS / 2.0)
    return Stretch(frame_numbers, middle - half, middle + half)


def _range_of(images: Sequence[StoredImage]) -> tuple[float, float] | None:
    """Values between which all pixels of some images lie, but for 1 % of each at either end."""
    ends = []
    for stored in images:
        try:
            image = stored.read()
        except SourceError:
            continue
        if image.dtype == np.uint16:
            ends.append(np.percentile(image[::_PIXEL_STEP, ::_PIXEL_STEP], _PERCENTILES))
    if not ends:
        return None
    return float(min(low for low, _ in ends)), float(max(high for _, high in ends))
