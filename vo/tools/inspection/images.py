"""Checks of a sample of images: brightness, blur, texture, repetition."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.types import Bytes
from vo.engine.frontend.image_faults import blur
from vo.recordings.sources.grey_levels import GreyLevels, find_grey_levels
from vo.recordings.sources.images import StoredImage, is_colour
from vo.tools.inspection.image_records import ImageStatistics

_DARK, _BRIGHT = 10, 250
_FAST_THRESHOLD = 12


class ImageReader:
    """Reads images of a camera as 8-bit grey images, and records unreadable ones."""

    def __init__(self, images: Sequence[StoredImage]) -> None:
        self._images = images
        self._levels = GreyLevels(8)
        self.unreadable: dict[int, str] = {}
        if images:
            self._levels = find_grey_levels(images)

    @property
    def bits(self) -> int:
        """Bits per pixel used by the camera."""
        return self._levels.bit_depth

    @property
    def has_colour(self) -> bool:
        """Whether the first readable image is in colour."""
        return is_colour(self._images)

    def read(self, number: int) -> Bytes | None:
        """An image (H, W); None if it is unreadable."""
        try:
            return self._levels.to_8_bits(self._images[number].read(), number)
        except SourceError as error:
            self.unreadable[number] = str(error)
            return None


def evenly_spaced(count: int, wanted: int) -> list[int]:
    """`wanted` evenly spaced numbers from 0 to `count - 1`."""
    if count <= wanted:
        return list(range(count))
    return sorted({round(i) for i in np.linspace(0, count - 1, wanted).tolist()})


def check_images(
    reader: ImageReader, count: int, wanted: int
) -> tuple[list[ImageStatistics], tuple[int, int], list[int]]:
    """Check evenly spaced images of a recording, each compared with the previous one.

    Returns statistics of the checked images, width and height of the first one, and the numbers of
    images of other sizes.
    """
    looks: list[ImageStatistics] = []
    size: tuple[int, int] = (0, 0)
    others: list[int] = []
    last: tuple[int, Bytes | None] = (-1, None)
    for number in evenly_spaced(count, wanted):
        before = last[1] if last[0] == number - 1 else reader.read(number - 1) if number else None
        image = reader.read(number)
        last = (number, image)
        if image is None:
            continue
        size = size if size[0] else (image.shape[1], image.shape[0])
        if (image.shape[1], image.shape[0]) != size:
            others.append(number)
        repeats = None if before is None else bool(np.array_equal(before, image))
        looks.append(_statistics(number, image, repeats))
    return looks, size, others


def _statistics(number: int, image: Bytes, repeats: bool | None) -> ImageStatistics:
    return ImageStatistics(
        frame=number,
        mean_grey=float(image.mean()),
        dark=float((image < _DARK).mean()),
        bright=float((image > _BRIGHT).mean()),
        blur=blur(image),
        corners=len(cv2.FastFeatureDetector.create(_FAST_THRESHOLD).detect(image)),
        repeats=repeats,
    )


def frame_ranges(frames: Sequence[int], checked: Sequence[int]) -> list[tuple[int, int]]:
    """Ranges (first, last) of frames that are consecutive among the checked ones."""
    place = {frame: i for i, frame in enumerate(checked)}
    joined: list[list[int]] = [[frame] for frame in frames[:1]]
    for before, frame in pairwise(frames):
        if place[frame] == place[before] + 1:
            joined[-1].append(frame)
        else:
            joined.append([frame])
    return [(each[0], each[-1]) for each in joined]
