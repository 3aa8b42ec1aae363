"""Patches around features, sampled at the pyramid levels of the features."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import compiled
from vo.base.types import Bytes, Floats
from vo.engine.places.records import PATCH_PX


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
    """Sample patches around pixels (k, 2) of an image into rows (k,) of (n, side, side).

    All pixels of a patch lie between four others in the same way, so that it has four weights,
    which are multiples of 2^-14 here: sums of whole numbers are compiled to vector instructions.
    """
    height, width = image.shape
    side = PATCH_PX
    area = np.empty((side + 1, side + 1), dtype=np.int32)
    for n in range(len(rows)):
        u, v = centre[n, 0] - side // 2, centre[n, 1] - side // 2
        x, y = int(np.floor(u)), int(np.floor(v))
        fx, fy = int(np.rint((u - x) * 128)), int(np.rint((v - y) * 128))
        is_inside = x >= 0 and y >= 0 and x + side < width and y + side < height
        for i in range(side + 1):
            if is_inside:
                for j in range(side + 1):
                    area[i, j] = image[y + i, x + j]
            else:
                row = min(max(y + i, 0), height - 1)
                for j in range(side + 1):
                    area[i, j] = image[row, min(max(x + j, 0), width - 1)]
        weights = (128 - fx) * (128 - fy), fx * (128 - fy), (128 - fx) * fy, fx * fy
        a, b = np.int32(weights[0]), np.int32(weights[1])
        c, d = np.int32(weights[2]), np.int32(weights[3])
        patch = result[rows[n]]
        for i in range(side):
            upper, lower = area[i], area[i + 1]
            for j in range(side):
                total = a * upper[j] + b * upper[j + 1] + c * lower[j] + d * lower[j + 1]
                patch[i, j] = np.uint8((total + np.int32(8192)) >> np.int32(14))
