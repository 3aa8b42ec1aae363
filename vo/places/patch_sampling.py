"""Patches around features, sampled at the pyramid levels of the features."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.compiling.function import compiled
from vo.places.records import PATCH_PX
from vo.types import Bytes, Floats


def sampled_patches(
    image: Bytes, xy: Floats, octave: NDArray[np.int32], scale_factor: float
) -> Bytes:
    """(n, PATCH_PX, PATCH_PX) around pixels (n, 2) of an image, at their pyramid levels (n,).

    Bilinear; edges are repeated.
    """
    result = np.zeros((len(xy), PATCH_PX, PATCH_PX), np.uint8)
    height, width = image.shape
    reduced, size = image, (width, height)
    for level in range(int(octave.max(initial=-1)) + 1):
        if level > 0:  # of the level before, as for the features: much faster than of the image
            size = tuple(math.ceil(side / scale_factor**level) for side in (width, height))
            reduced = cv2.resize(reduced, size, interpolation=cv2.INTER_LINEAR)
        rows = np.flatnonzero(octave == level)
        if len(rows):
            ratio = np.array([size[0] / width, size[1] / height])
            centre = ((xy[rows] + 0.5) * ratio - 0.5).astype(np.float32)
            _sample(reduced, centre, rows, result)
    return result


@compiled
def _sample(image, centre, rows, result):  # type: ignore[no-untyped-def]
    """Sample patches around pixels (k, 2) of an image into rows (k,) of (n, side, side)."""
    height, width = image.shape
    side = result.shape[1]
    half, one, rounder = np.float32(side // 2), np.float32(1.0), np.float32(2**23)
    column, part = np.empty((side, 2), dtype=np.uint64), np.empty(side, dtype=np.float32)
    for n in range(len(rows)):
        for j in range(side):
            u = centre[n, 0] - half + np.float32(j)
            x = int(np.floor(u))
            part[j] = u - np.float32(x)
            column[j, 0] = min(max(x, 0), width - 1)
            column[j, 1] = min(max(x + 1, 0), width - 1)
        for i in range(side):
            v = centre[n, 1] - half + np.float32(i)
            y = int(np.floor(v))
            fy = v - np.float32(y)
            y0, y1 = (
                np.uint64(min(max(y, 0), height - 1)),
                np.uint64(min(max(y + 1, 0), height - 1)),
            )
            for j in range(side):
                x0, x1, fx = column[j, 0], column[j, 1], part[j]
                above = (one - fx) * np.float32(image[y0, x0]) + fx * np.float32(image[y0, x1])
                below = (one - fx) * np.float32(image[y1, x0]) + fx * np.float32(image[y1, x1])
                grey = (one - fy) * above + fy * below
                result[rows[n], i, j] = np.uint8(grey + rounder - rounder)  # 2^23: to integers
