"""Neighbouring pixels: nearest points, and pixels away from others."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bools, Floats, Floats32

NEIGHBOURS = 3
_CELL_PX = 6.0  # pixels in the same cell of this side, or in touching cells, are neighbours


def median_of_nearest(xy: Floats, known_xy: Floats, known: Floats) -> Floats:
    """Median (N,) of the values of the three points nearest to each pixel.

    Args:
        xy: (N, 2) pixels.
        known_xy: (M, 2) pixels with a value, at least three; of equally distant ones the first
            count.
        known: (M,) their values.
    """
    return np.asarray(
        _median_of_nearest(
            np.ascontiguousarray(xy), np.ascontiguousarray(known_xy), np.ascontiguousarray(known)
        )
    )


def distances(xy: Floats, other_xy: Floats) -> Floats:
    """Distances (n,) of pixels (n, 2), in a third of the time of `np.linalg.norm`."""
    off = xy - other_xy
    off *= off
    return np.asarray(np.sqrt(off[:, 0] + off[:, 1]))


def far_from(xy: Floats | Floats32, taken_xy: Floats) -> Bools:
    """Mask (N,) of pixels without a taken pixel (M, 2) in their cell or in touching cells."""
    pixels = np.ascontiguousarray(xy, dtype=np.float64)
    return np.asarray(_far_from(pixels, np.ascontiguousarray(taken_xy)))


@compiled
def _far_from(xy, taken_xy):  # type: ignore[no-untyped-def]
    """See `far_from`; marks the neighbourhood of taken cells, then looks pixels up."""
    columns, rows = 0, 0
    for m in range(len(taken_xy)):
        column, row = _cell(taken_xy[m])
        columns, rows = max(columns, column), max(rows, row)
    near = np.zeros((columns + 2, rows + 2), dtype=np.bool_)
    for m in range(len(taken_xy)):
        column, row = _cell(taken_xy[m])
        near[column - 1 : column + 2, row - 1 : row + 2] = True
    far = np.empty(len(xy), dtype=np.bool_)
    for n in range(len(xy)):
        column, row = _cell(xy[n])
        far[n] = column > columns + 1 or row > rows + 1 or not near[column, row]
    return far


@compiled
def _cell(pixel):  # type: ignore[no-untyped-def]
    """Column and row, at least 1; pixels outside of the image are in cells along its edge."""
    column, row = int(np.floor(pixel[0] / _CELL_PX)), int(np.floor(pixel[1] / _CELL_PX))
    return max(column, -1) + 2, max(row, -1) + 2


@compiled
def _median_of_nearest(xy, known_xy, known):  # type: ignore[no-untyped-def]
    """See `median_of_nearest`; the three nearest are kept by insertion."""
    result = np.empty(len(xy))
    for n in range(len(xy)):
        first = second = third = np.inf
        a, b, c = 0, 0, 0
        for m in range(len(known)):
            dx, dy = known_xy[m, 0] - xy[n, 0], known_xy[m, 1] - xy[n, 1]
            squared = dx * dx + dy * dy
            if squared >= third:
                continue
            if squared < first:
                first, second, third = squared, first, second
                a, b, c = m, a, b
            elif squared < second:
                second, third = squared, second
                b, c = m, b
            else:
                third, c = squared, m
        low, high = min(known[a], known[b]), max(known[a], known[b])
        result[n] = max(low, min(high, known[c]))
    return result
