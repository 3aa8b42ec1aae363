"""Detection of images that repeat the one before, as a camera that has frozen gives them."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bytes

_ROW_STEP = 16  # every sixteenth row is enough
_MIN_PIXELS = 50  # at edges, and in flat parts, to compare their changes
# Mean change of flat parts, in grey levels, above which images differ by more than noise.
_MAX_NOISE = 6.0
# Apparent motion, in pixels, below which two images show the same. Noise of 4 grey levels gives
# 0.05, JPEG of quality 50 up to 0.17, real motion by a pixel 0.5 to 1.
_MAX_STILL_PX = 0.18
_MIN_MOVING_PX = 0.4  # apparent motion from which an image has certainly changed


class Repetition(Enum):
    """How an image relates to the one before it."""

    NONE = 0
    SIMILAR = 1  # the same but for noise: the scene stands still, or the camera has frozen
    IDENTICAL = 2  # byte by byte


class ImageChange(NamedTuple):
    """Change from one image to the next.

    Attributes:
        repetition: whether the image repeats the one before.
        motion_px: apparent motion, saturated at about a pixel; NaN if unknown.
    """

    repetition: Repetition = Repetition.NONE
    motion_px: float = np.nan


class RepetitionDetector:
    """Compares the images of each frame, as recorded, with those of the frame before.

    Attributes:
        is_right_frozen: whether the newest right image repeats, but the left ones have not since
            the right ones began to. A pair that stands still repeats together.
    """

    def __init__(self) -> None:
        self.is_right_frozen = False
        self._before: tuple[Bytes | None, ...] = ()
        self._has_stood = False  # left and right, since the right image last changed

    def update(self, images: tuple[Bytes | None, ...]) -> tuple[ImageChange, ...]:
        """Change of the next images, by camera."""
        before = self._before or (None,) * len(images)
        self._before = images
        changes = tuple(map(image_change, before, images))
        if len(changes) > 1:
            left, right = changes[0], changes[1]
            is_repeated = right.repetition is not Repetition.NONE
            has_stood = self._has_stood or left.repetition is not Repetition.NONE
            self._has_stood = is_repeated and has_stood
            is_frozen = is_right_frozen(left, right)
            is_certain = right.repetition is Repetition.IDENTICAL or not self._has_stood
            self.is_right_frozen = is_frozen and is_certain
        return changes


def image_change(before: Bytes | None, now: Bytes | None) -> ImageChange:
    """Change between two images (H, W) of a camera; unknown where one is missing."""
    if before is None or now is None or before.shape != now.shape:
        return ImageChange()
    difference, motion_px, has_edges = _compare(before, now)
    if not has_edges:  # images of a covered lens are alike too
        return ImageChange()
    if difference == 0 and np.array_equal(before, now):
        return ImageChange(Repetition.IDENTICAL, 0.0)
    is_still = abs(motion_px) < _MAX_STILL_PX
    return ImageChange(Repetition.SIMILAR if is_still else Repetition.NONE, motion_px)


def is_right_frozen(left: ImageChange, right: ImageChange) -> bool:
    """Whether the right image repeats the one before it, but the left one does not."""
    if left.repetition is not Repetition.NONE:
        return False
    if right.repetition is Repetition.SIMILAR:
        return left.motion_px > _MIN_MOVING_PX
    return right.repetition is Repetition.IDENTICAL


def rig_repetition(
    before: Sequence[Bytes | None], now: Sequence[Bytes | None], changes: Sequence[ImageChange]
) -> Repetition:
    """How the images of a rig together relate to those before; None for cameras that do not count.

    Images without edges have no `ImageChange`, and may still be the same.
    """
    found = set()
    for image, newest, change in zip(before, now, changes, strict=True):
        if image is None or newest is None:
            continue
        kind = change.repetition
        if kind is Repetition.NONE and not np.array_equal(image, newest):
            return kind
        found.add(kind)
    kinds = Repetition.SIMILAR, Repetition.IDENTICAL
    return next((kind for kind in kinds if kind in found), Repetition.NONE)


@compiled
def _compare(before, now):  # type: ignore[no-untyped-def]
    """Sum of absolute differences, apparent motion in pixels, and whether there are edges.

    Motion by m pixels changes the grey level at an edge of gradient g by m g; noise and exposure
    change flat parts as much as edges. The motion is NaN if flat parts are missing, or change by
    more than noise and as much as edges.
    """
    # Signed integers, and sums without branches: the compiler processes several pixels at a time.
    height, width = now.shape
    total = edge = flat = gradient = edges = flats = np.int64(0)
    for v in range(_ROW_STEP // 2, height, _ROW_STEP):
        for u in range(1, width - 1):
            slope = abs(np.int64(now[v, u + 1]) - np.int64(now[v, u - 1]))  # twice the gradient
            change = min(abs(np.int64(now[v, u]) - np.int64(before[v, u])), np.int64(64))
            is_edge, is_flat = np.int64(slope >= 20), np.int64(slope <= 4)
            total += change
            edge += is_edge * change
            gradient += is_edge * slope
            edges += is_edge
            flat += is_flat * change
            flats += is_flat
    has_edges = edges >= _MIN_PIXELS
    if not has_edges or flats < _MIN_PIXELS:
        return total, np.nan, has_edges
    motion_px = (edge / edges - flat / flats) / (0.5 * gradient / edges)
    is_unclear = flat > _MAX_NOISE * flats and motion_px < _MIN_MOVING_PX
    return total, np.nan if is_unclear else motion_px, has_edges
