"""FAST corners spread evenly over the image: a lower threshold in poor cells, the best of each."""

from __future__ import annotations

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from vo.types import Bytes, Floats32

_RING = 3  # radius of the ring of pixels that FAST compares
_PER_CELL = 3.0  # corners that a cell should hold


class FastGrid:
    """Finds FAST corners in an image, at most `count`, spread over a grid of square cells.

    Where a cell has no corner at the normal threshold, it is searched again at the lower one, so
    that shade and haze keep their corners. The best of every cell are taken first, then the
    second best of every cell, and so on.

    Source: Rosten, Drummond, "Machine learning for high-speed corner detection", ECCV 2006.
    """

    def __init__(self, threshold: int, low_threshold: int, border: int) -> None:
        self._normal = cv2.FastFeatureDetector.create(threshold, True)
        self._low = cv2.FastFeatureDetector.create(low_threshold, True)
        self._border = border

    def detect(self, image: Bytes, count: int) -> tuple[NDArray[np.int32], Floats32]:
        """Pixels x, y (N, 2) and scores (N,) of corners of an (H, W) uint8 image."""
        height, width = image.shape
        b = self._border
        if count == 0 or min(height, width) <= 2 * b:
            return np.empty((0, 2), np.int32), np.empty(0, np.float32)
        size = int(max(np.sqrt(width * height * _PER_CELL / count), 12.0))
        shape = ((height - 2 * b - 1) // size + 1, (width - 2 * b - 1) // size + 1)
        found = [_corners(self._normal, image, b, b, width - b, height - b)]
        cells = _cell_of(found[0][0], b, size, shape[1])
        for cell in np.flatnonzero(np.bincount(cells, minlength=shape[0] * shape[1]) == 0):
            x, y = b + (cell % shape[1]) * size, b + (cell // shape[1]) * size
            right, bottom = min(x + size, width - b), min(y + size, height - b)
            found.append(_corners(self._low, image, int(x), int(y), int(right), int(bottom)))
        xy = np.concatenate([f[0] for f in found])
        scores = np.concatenate([f[1] for f in found])
        cells = _cell_of(xy, b, size, shape[1])
        rows = _best_of_cells(scores.astype(np.int64), cells, shape[0] * shape[1], count)
        return np.ascontiguousarray(xy[rows]), scores[rows]


def _corners(
    detector: cv2.FastFeatureDetector, image: Bytes, left: int, top: int, right: int, bottom: int
) -> tuple[NDArray[np.int32], Floats32]:
    """Corners with left <= x < right and top <= y < bottom."""
    part = image[top - _RING : bottom + _RING, left - _RING : right + _RING]
    keypoints = detector.detect(part)
    if not keypoints:
        return np.empty((0, 2), np.int32), np.empty(0, np.float32)
    xy = np.asarray(cv2.KeyPoint.convert(keypoints)) + (left - _RING, top - _RING)
    scores = np.fromiter((k.response for k in keypoints), np.float32, len(keypoints))
    return xy.astype(np.int32), scores


def _cell_of(xy: NDArray[np.int32], border: int, size: int, columns: int) -> NDArray[np.int64]:
    cell = (xy[:, 1] - border) // size * columns + (xy[:, 0] - border) // size
    return cell.astype(np.int64)


@numba.njit(cache=True, nogil=True)
def _best_of_cells(scores, cell_of, cells, count):  # type: ignore[no-untyped-def]
    """Rows of the best of every cell, then of the second best, …, `count` at most, in order.

    Rank in the cell decides, then score; equal corners keep their order.
    """
    n = len(scores)
    if n <= count:
        return np.arange(n)
    strongest_first = _sorted_stably(255 - scores, 256, np.arange(n))
    seen = np.zeros(cells, dtype=np.int64)
    rank = np.empty(n, dtype=np.int64)
    for i in strongest_first:
        rank[i] = seen[cell_of[i]]
        seen[cell_of[i]] += 1
    order = _sorted_stably(rank, seen.max(), strongest_first)
    return np.sort(order[:count])


@numba.njit(cache=True, nogil=True)
def _sorted_stably(keys, limit, rows):  # type: ignore[no-untyped-def]
    """Rows in order of their keys, which are below `limit`."""
    starts = np.zeros(limit + 1, dtype=np.int64)
    for i in rows:
        starts[keys[i] + 1] += 1
    starts = np.cumsum(starts)
    result = np.empty(len(rows), dtype=np.int64)
    for i in rows:
        result[starts[keys[i]]] = i
        starts[keys[i]] += 1
    return result
