"""Thumbnails: images reduced to the mean grey levels of areas."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bytes

_HEIGHT = 120


def thumbnail_of(image: Bytes) -> Bytes:
    """(h, w) of an image, at a height of at most 120 pixels.

    As by `cv2.INTER_AREA`, which takes seven times as long where sizes are no multiples.
    """
    height, width = image.shape
    small_height = min(_HEIGHT, height)
    result = np.empty((small_height, max(1, round(width * small_height / height))), np.uint8)
    _reduce(image, result)
    return result


@compiled
def _reduce(image, result):  # type: ignore[no-untyped-def]
    """Mean grey level of the area of an image that each pixel of a smaller one covers."""
    height, width = image.shape
    down, across = height / len(result), width / result.shape[1]
    column = np.empty(width, np.float32)
    for i in range(len(result)):
        column[:] = 0.0
        top, bottom = i * down, (i + 1) * down
        for y in range(int(top), min(int(np.ceil(bottom)), height)):
            weight = np.float32((min(bottom, y + 1.0) - max(top, y)) / down)
            row = image[y]
            for x in range(width):
                column[x] += weight * np.float32(row[x])
        first, rest = 0, np.float32(0.0)  # of the column that the pixel before has a part of
        for j in range(result.shape[1]):
            right = (j + 1) * across
            last = min(int(right), width)
            total = rest
            for x in range(np.uint64(first), np.uint64(last)):  # unsigned: no test for negative
                total += column[x]
            rest = np.float32(0.0)
            if last < width:
                share = np.float32(right - last) * column[last]
                total, rest = total + share, column[last] - share
            result[i, j] = np.uint8(np.rint(total / across))
            first = last + 1
