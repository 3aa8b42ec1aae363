"""Selection of some detections, spread over the image."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Ints
from vo.engine.features.detections import Detections

Selection = Literal["grid", "ssc", "strongest"]

_PER_CELL = 3.0  # detections wanted per cell of the grid
_SSC_TOLERANCE = 0.1  # of the count that suppression via square covering aims at
_SSC_STEPS = 30


def select(
    detections: Detections, count: int, shape: tuple[int, ...], how: Selection
) -> Detections:
    """At most `count` detections of an image of shape (H, W), strongest first within a rank.

    `grid` takes the best of every cell, then the second best, and so on; `ssc` drops neighbours
    of stronger ones as far as the count allows; `strongest` ignores where they are.
    """
    if len(detections) <= count:
        return detections
    if how == "grid":
        return detections.select(_by_grid(detections, count, shape))
    if how == "ssc":
        return detections.select(_by_covering(detections, count, shape))
    return detections.select(np.arange(count))


def _by_grid(detections: Detections, count: int, shape: tuple[int, ...]) -> Ints:
    side = max(np.sqrt(shape[0] * shape[1] * _PER_CELL / count), 12.0)
    columns = int(shape[1] / side) + 1
    cell = (detections.xy[:, 1] // side).astype(np.int64) * columns
    cell += (detections.xy[:, 0] // side).astype(np.int64)
    order = np.argsort(cell, kind="stable")  # strongest first within each cell
    starts = np.flatnonzero(np.r_[True, np.diff(cell[order]) != 0])
    sizes = np.diff(np.r_[starts, len(order)])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - np.repeat(starts, sizes)
    return np.sort(np.argsort(rank, kind="stable")[:count])


def _by_covering(detections: Detections, count: int, shape: tuple[int, ...]) -> Ints:
    """Suppression via square covering: a binary search for the width of the suppressed squares.

    Source: Bailo et al., "Efficient adaptive non-maximal suppression algorithms for homogeneous
    spatial keypoint distribution", Pattern Recognition Letters 2018, algorithm 3.
    """
    xy = np.ascontiguousarray(detections.xy, dtype=np.float64)
    low, high = 1.0, float(max(shape[:2]))
    best = np.arange(count)
    for _ in range(_SSC_STEPS):
        width = (low + high) / 2.0
        rows = _covering(xy, width, shape[0], shape[1])
        if len(rows) >= count:
            best, low = rows, width
            if len(rows) <= count * (1.0 + _SSC_TOLERANCE):
                break
        else:
            high = width
        if high - low < 0.5:
            break
    return best[:count]


@compiled
def _covering(xy, width, rows, columns):  # type: ignore[no-untyped-def]
    """Rows of points, strongest first, none within `width` pixels of a stronger one, by cells."""
    cell = width / 2.0
    across, down = int(columns / cell) + 1, int(rows / cell) + 1
    is_covered = np.zeros((down, across), dtype=np.bool_)
    kept = np.empty(len(xy), dtype=np.int64)
    count = 0
    for n in range(len(xy)):
        column = min(max(int(xy[n, 0] / cell), 0), across - 1)
        row = min(max(int(xy[n, 1] / cell), 0), down - 1)
        if is_covered[row, column]:
            continue
        kept[count] = n
        count += 1
        for r in range(max(row - 2, 0), min(row + 3, down)):
            for c in range(max(column - 2, 0), min(column + 3, across)):
                is_covered[r, c] = True
    return kept[:count]
