"""FAST corners, evenly distributed over a grid, with a lower threshold in cells without any."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Bytes, Floats32

_RING = 3  # radius of the ring of pixels that a corner is compared with
_ON_RING = 16  # pixels on it
_PER_CELL = 3.0  # average number of corners per cell
_NO_MASK = np.empty((0, 0), np.uint8)


class FastGrid:
    """Detector of FAST-9 corners, distributed over a grid of square cells.

    A corner has nine consecutive pixels on the ring around it that are all brighter, or all darker,
    by more than the threshold, and a higher contrast than its eight neighbours. Cells without
    corners at the normal threshold are searched at the lower one, so that dark and hazy regions
    keep their corners. The best corner of every cell is chosen first, then the second best of
    every cell, and so on.

    Source: Rosten, Drummond, "Machine learning for high-speed corner detection", ECCV 2006.
    """

    def __init__(self, threshold: int, low_threshold: int, border: int) -> None:
        if border < _RING:
            raise ValueError(f"border is {border}, at least {_RING}")
        self._thresholds = threshold, low_threshold
        self._border = border

    def detect(
        self, image: Bytes, count: int, mask: Bytes | None = None
    ) -> tuple[NDArray[np.int32], Floats32]:
        """Pixels x, y (N, 2) and scores (N,) of at most `count` corners of an (H, W) uint8 image.

        The score is the highest threshold at which the pixel is still a corner. Where a mask (H, W)
        is 0 there are none, and as many more elsewhere.
        """
        height, width = image.shape
        b = self._border
        if count == 0 or min(height, width) <= 2 * b:
            return np.empty((0, 2), np.int32), np.empty(0, np.float32)
        area = width * height if mask is None else int(np.count_nonzero(mask))
        size = int(max(sqrt(area * _PER_CELL / count), 12.0))
        hidden = _NO_MASK if mask is None else mask
        xy, scores = _corners(image, hidden, b, *self._thresholds, size, count)
        return xy, scores


@compiled
def _corners(image, mask, border, threshold, low_threshold, size, count):  # type: ignore[no-untyped-def]
    """Pixels and scores of at most `count` corners, where the mask, unless empty, is not 0."""
    contrast = _contrasts(image, border - _RING)
    if mask.size > 0:
        for y in range(contrast.shape[0]):
            for x in range(contrast.shape[1]):
                if mask[y + border, x + border] == 0:
                    contrast[y, x] = 0
    return _best_corners(contrast, border, threshold, low_threshold, size, count)


@compiled
def _contrasts(image, edge):  # type: ignore[no-untyped-def]
    """Contrast of the pixels whose ring lies inside of an edge; a corner's score is one less.

    The seven rows that a ring spans are separate arrays, so that the loop over x has contiguous
    loads only and becomes vector instructions.
    """
    rows = image[edge : image.shape[0] - edge, edge : image.shape[1] - edge]
    height, width = rows.shape[0] - 2 * _RING, rows.shape[1] - 2 * _RING
    contrast = np.empty((height, width), dtype=np.uint8)
    for y in range(height):
        r0, r1, r2, r3 = rows[y], rows[y + 1], rows[y + 2], rows[y + 3]
        r4, r5, r6 = rows[y + 4], rows[y + 5], rows[y + 6]
        for x in range(width):
            top = r0[x + 2], r0[x + 3], r0[x + 4], r1[x + 5]
            right = r2[x + 6], r3[x + 6], r4[x + 6], r5[x + 5]
            bottom = r6[x + 4], r6[x + 3], r6[x + 2], r5[x + 1]
            left = r4[x], r3[x], r2[x], r1[x + 1]
            contrast[y, x] = _contrast(r3[x + 3], top + right + bottom + left)
    return contrast


@compiled(forceinline=True, **NO_REFCOUNT)
def _contrast(centre, ring):  # type: ignore[no-untyped-def]
    """Grey levels by which some nine adjacent pixels of a ring of 16 all exceed the centre.

    Or by which they all fall below it, whichever is more; 0 if no nine do either. Without branches
    and with 8 bits throughout, so that LLVM turns the loop over pixels into vector instructions.
    """
    v0, v1, v2, v3, v4, v5, v6, v7, v8, v9, v10, v11, v12, v13, v14, v15 = ring
    even, odd = (v0, v2, v4, v6, v8, v10, v12, v14), (v1, v3, v5, v7, v9, v11, v13, v15)
    brighter = max(_extreme_arc(even, odd, _lower, _higher), centre)
    darker = min(_extreme_arc(even, odd, _higher, _lower), centre)
    return max(np.uint8(brighter - centre), np.uint8(centre - darker))


@compiled(forceinline=True, **NO_REFCOUNT)
def _extreme_arc(even, odd, lower, higher):  # type: ignore[no-untyped-def]
    """Highest minimum of nine adjacent pixels of a ring, given by its even and odd pixels.

    With `lower` and `higher` exchanged, the lowest maximum.
    """
    two = lower(odd, even[1:] + even[:1])
    four = lower(two, two[1:] + two[:1])
    eight = lower(four, four[2:] + four[:2])
    nine = lower(eight, higher(even, odd[4:] + odd[:4]))  # with the pixel before or after
    nine = higher(nine, nine[4:] + nine[:4])
    nine = higher(nine, nine[2:] + nine[:2])
    return higher(nine, nine[1:] + nine[:1])[0]


@compiled(forceinline=True, **NO_REFCOUNT)
def _lower(a, b):  # type: ignore[no-untyped-def]
    """Minima of two tuples of eight."""
    a0, a1, a2, a3, a4, a5, a6, a7 = a
    b0, b1, b2, b3, b4, b5, b6, b7 = b
    first = min(a0, b0), min(a1, b1), min(a2, b2), min(a3, b3)
    return first + (min(a4, b4), min(a5, b5), min(a6, b6), min(a7, b7))


@compiled(forceinline=True, **NO_REFCOUNT)
def _higher(a, b):  # type: ignore[no-untyped-def]
    """Maxima of two tuples of eight."""
    a0, a1, a2, a3, a4, a5, a6, a7 = a
    b0, b1, b2, b3, b4, b5, b6, b7 = b
    first = max(a0, b0), max(a1, b1), max(a2, b2), max(a3, b3)
    return first + (max(a4, b4), max(a5, b5), max(a6, b6), max(a7, b7))


@compiled
def _best_corners(contrast, border, threshold, low_threshold, size, count):  # type: ignore[no-untyped-def]
    """Pixels and scores of at most `count` corners; `border` is added to their places."""
    height, width = contrast.shape
    columns = (width - 1) // size + 1
    cells = (height - 1) // size * columns + columns
    found = np.empty((height * width, 2), dtype=np.int32)  # x, y; there cannot be more
    none = np.int64(0)
    n = _add_corners(contrast, (none, none, height, width), threshold, found, none)
    is_empty = np.ones(cells, dtype=np.bool_)
    for i in range(n):
        is_empty[found[i, 1] // size * columns + found[i, 0] // size] = False
    for cell in range(cells):
        if is_empty[cell]:
            top, left = cell // columns * size, cell % columns * size
            part = top, left, min(top + size, height), min(left + size, width)
            n = _add_corners(contrast, part, low_threshold, found, n)
    scores, cell_of = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in range(n):
        x, y = found[i]
        scores[i] = contrast[y, x] - 1
        cell_of[i] = y // size * columns + x // size
    is_kept = _best_of_cells(scores, cell_of, cells, count)
    kept = min(n, count)
    xy, kept_scores = np.empty((kept, 2), dtype=np.int32), np.empty(kept, dtype=np.float32)
    k = 0
    for i in range(n):
        if is_kept[i]:
            xy[k, 0], xy[k, 1] = found[i, 0] + border, found[i, 1] + border
            kept_scores[k] = scores[i]
            k += 1
    return xy, kept_scores


@compiled
def _add_corners(contrast, part, threshold, found, n):  # type: ignore[no-untyped-def]
    """Append x and y of the corners in a part of the image; gives their new number."""
    top, left, bottom, right = part
    beyond = np.zeros(right - left, dtype=np.uint8)  # pixels outside of the part are ignored
    is_corner = np.zeros((right - left + 7) // 8 * 8, dtype=np.uint8)
    eights = is_corner.view(np.uint64)
    for y in range(top, bottom):
        above = contrast[y - 1, left:right] if y > top else beyond
        below = contrast[y + 1, left:right] if y + 1 < bottom else beyond
        _mark_corners(above, contrast[y, left:right], below, np.uint8(threshold), is_corner)
        for eight in range(len(eights)):
            if eights[eight] == 0:  # eight pixels at once; almost always
                continue
            for x in range(8 * eight, 8 * eight + 8):
                if is_corner[x]:
                    found[n, 0], found[n, 1] = left + x, y
                    n += 1
    return n


@compiled(forceinline=True, **NO_REFCOUNT)
def _mark_corners(above, row, below, minimum, is_corner):  # type: ignore[no-untyped-def]
    """Set where pixels of a row exceed the minimum and their neighbours in three rows."""
    last, one, none = len(row) - 1, np.uint8(1), np.uint8(0)
    for x in range(1, last):
        around = max(max(above[x - 1], above[x]), max(above[x + 1], row[x - 1]))
        around = max(around, max(row[x + 1], max(below[x - 1], max(below[x], below[x + 1]))))
        is_corner[x] = one if row[x] > max(around, minimum) else none
    for x in (0, last):
        around = max(above[x], below[x])
        for u in (x - 1, x + 1):
            if 0 <= u <= last:
                around = max(around, max(row[u], max(above[u], below[u])))
        is_corner[x] = one if row[x] > max(around, minimum) else none


@compiled
def _best_of_cells(scores, cell_of, cells, count):  # type: ignore[no-untyped-def]
    """Mask (N,) of at most `count` corners, by rank within their cell, then by score.

    Of equal corners the first is kept.
    """
    n = len(scores)
    is_kept = np.ones(n, dtype=np.bool_)
    if n <= count:
        return is_kept
    weakness, rows = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in range(n):
        weakness[i], rows[i] = 255 - scores[i], i
    strongest_first = _sorted_stably(weakness, rows, np.int64(256))
    seen, rank = np.zeros(cells, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in strongest_first:
        rank[i] = seen[cell_of[i]]
        seen[cell_of[i]] += 1
    for i in _sorted_stably(rank, strongest_first, n)[count:]:
        is_kept[i] = False
    return is_kept


@compiled
def _sorted_stably(keys, rows, count):  # type: ignore[no-untyped-def]
    """Rows in order of their keys, which are less than `count`."""
    starts = np.zeros(count + 1, dtype=np.int64)
    for i in rows:
        starts[keys[i] + 1] += 1
    for key in range(len(starts) - 1):
        starts[key + 1] += starts[key]
    result = np.empty(len(rows), dtype=np.int64)
    for i in rows:
        result[starts[keys[i]]] = i
        starts[keys[i]] += 1
    return result
