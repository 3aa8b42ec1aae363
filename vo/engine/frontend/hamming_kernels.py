"""Kernels of Hamming matching.

Each `best_…` gives for every query the row of its nearest train feature (-1 for none) and the
distance. Candidates of a query are at most one octave off; a nearest one counts if its distance is
at most `max_distance` and below `ratio` times the second-nearest (Lowe 2004). Train features are
sorted into a `Grid` of square cells, so that only cells of the search region are visited.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Floats, Ints

NO_MATCH = -1
_CELL_PX = 32.0

_PAIRS, _NIBBLES = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333)
_BYTES, _SUM_OF_BYTES = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x0101010101010101)
_1, _2, _4, _56 = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)


@compiled(**NO_REFCOUNT)
def hamming(a, b):  # type: ignore[no-untyped-def]
    """Number of bits in which two rows of four uint64 words differ."""
    return (
        _population_count(a[0] ^ b[0])
        + _population_count(a[1] ^ b[1])
        + _population_count(a[2] ^ b[2])
        + _population_count(a[3] ^ b[3])
    )


@compiled(**NO_REFCOUNT)
def _population_count(word):  # type: ignore[no-untyped-def]
    """Number of bits that are set in a uint64; LLVM turns these lines into one instruction.

    Source: Warren, "Hacker's Delight", 2nd edition, 2012, figure 5-2.
    """
    word = word - ((word >> _1) & _PAIRS)
    word = (word & _NIBBLES) + ((word >> _2) & _NIBBLES)
    return (((word + (word >> _4)) & _BYTES) * _SUM_OF_BYTES) >> _56


class PackedFeatures(NamedTuple):
    """Features as the kernels take them; rows belong together.

    Attributes:
        xy: (N, 2) pixels; ignored where a kernel does not need them.
        octave: (N,) int32.
        words: (N, 4) uint64, the bits of the descriptors.
    """

    xy: Floats
    octave: NDArray[np.int32]
    words: NDArray[np.uint64]


class Grid(NamedTuple):
    """Features (M,) sorted into square cells, row by row.

    Attributes:
        order: (M,) rows of the features, cell by cell.
        starts: (columns * rows + 1,) index in `order` at which each cell begins.
        columns: number of columns.
        rows: number of rows.
        top: v of its upper side.
    """

    order: Ints
    starts: Ints
    columns: int
    rows: int
    left: float
    top: float


def make_grid(xy: Floats) -> Grid:
    """Sort M > 0 pixels (M, 2) into cells."""
    return Grid(*_sorted_into_cells(xy, _CELL_PX))


@compiled
def one_to_one(matched, distance, count):  # type: ignore[no-untyped-def]
    """Of queries that chose the same of `count` train features, keep the nearest (or the first)."""
    result = np.full(len(matched), NO_MATCH)
    winner = np.full(count, -1)
    for n in range(len(matched)):
        m = matched[n]
        if m >= 0 and (winner[m] < 0 or distance[n] < distance[winner[m]]):
            winner[m] = n
    for m in range(len(winner)):
        if winner[m] >= 0:
            result[winner[m]] = m
    return result


@compiled
def _sorted_into_cells(xy, cell):  # type: ignore[no-untyped-def]
    """The fields of a `Grid`, by counting sort."""
    left, top = xy[0, 0], xy[0, 1]
    right, bottom = left, top
    for i in range(len(xy)):
        left, right = min(left, xy[i, 0]), max(right, xy[i, 0])
        top, bottom = min(top, xy[i, 1]), max(bottom, xy[i, 1])
    columns = int((right - left) / cell) + 1
    rows = int((bottom - top) / cell) + 1
    starts = np.zeros(columns * rows + 1, dtype=np.int64)
    cells = np.empty(len(xy), dtype=np.int64)
    for i in range(len(xy)):
        cells[i] = int((xy[i, 1] - top) / cell) * columns + int((xy[i, 0] - left) / cell)
        starts[cells[i] + 1] += 1
    for c in range(columns * rows):
        starts[c + 1] += starts[c]
    order = np.empty(len(xy), dtype=np.int64)
    filled = starts[:-1].copy()
    for i in range(len(xy)):
        order[filled[cells[i]]] = i
        filled[cells[i]] += 1
    return order, starts, columns, rows, left, top


@compiled
def best_in_circles(query, radius_px, train, grid, max_distance, ratio):  # type: ignore[no-untyped-def]
    """Search in circles of radii (N,) around the pixels of the query."""
    query_xy, train_xy, order, starts = query.xy, train.xy, grid.order, grid.starts
    query_words, train_words, columns = query.words, train.words, grid.columns
    query_octave, train_octave = query.octave, train.octave
    count = len(query_xy)
    matched = np.full(count, -1, dtype=np.int64)
    distance = np.full(count, 512, dtype=np.int64)
    for i in range(count):
        x, y, r = query_xy[i, 0] - grid.left, query_xy[i, 1] - grid.top, radius_px[i]
        first_column = max(int(np.floor((x - r) / _CELL_PX)), 0)
        last_column = min(int(np.floor((x + r) / _CELL_PX)), columns - 1)
        first_row = max(int(np.floor((y - r) / _CELL_PX)), 0)
        last_row = min(int(np.floor((y + r) / _CELL_PX)), grid.rows - 1)
        best, second, winner = 512, 512, -1
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                cell = row * columns + column
                for k in range(starts[cell], starts[cell + 1]):
                    j = order[k]
                    dx = train_xy[j, 0] - query_xy[i, 0]
                    dy = train_xy[j, 1] - query_xy[i, 1]
                    if dx * dx + dy * dy > r * r:
                        continue
                    if abs(train_octave[j] - query_octave[i]) > 1:
                        continue
                    d = int(hamming(query_words[i], train_words[j]))
                    if d < best:
                        second = best
                        best = d
                        winner = j
                    elif d < second:
                        second = d
        if winner >= 0 and best <= max_distance and best < ratio * second:
            matched[i] = winner
            distance[i] = best
    return matched, distance


@compiled
def best_of_all(query_words, train_words, max_distance, ratio):  # type: ignore[no-untyped-def]
    """Search everywhere, in all octaves; the query must be the nearest of its train feature too."""
    query_group = np.zeros(len(query_words), dtype=np.int64)
    train_group = np.zeros(len(train_words), dtype=np.int64)
    return best_in_groups(query_words, query_group, train_words, train_group, max_distance, ratio)


@compiled
def best_in_groups(  # type: ignore[no-untyped-def]
    query_words, query_group, train_words, train_group, max_distance, ratio
):
    """Search in the group (a number from 0) of each query only; else as `best_of_all`."""
    n, m, groups = len(query_words), len(train_words), 1
    for i in range(n):
        groups = max(groups, query_group[i] + 1)
    for j in range(m):
        groups = max(groups, train_group[j] + 1)
    start = np.zeros(groups + 1, dtype=np.int64)
    for j in range(m):
        start[train_group[j] + 1] += 1
    for group in range(groups):
        start[group + 1] += start[group]
    order, words, filled = np.empty(m, dtype=np.int64), np.empty_like(train_words), start.copy()
    for j in range(m):  # sorted by group
        order[filled[train_group[j]]] = j
        for c in range(train_words.shape[1]):  # a row at once takes 1 s more to compile
            words[filled[train_group[j]], c] = train_words[j, c]
        filled[train_group[j]] += 1
    matched = np.full(n, -1, dtype=np.int64)
    distance = np.full(n, 512, dtype=np.int64)
    back_best = np.full(m, 512, dtype=np.int64)
    back = np.full(m, -1, dtype=np.int64)
    for i in range(n):
        best, second, winner = 512, 512, -1
        first, last = start[query_group[i]], start[query_group[i] + 1]
        for j in range(np.uint64(first), np.uint64(last)):  # unsigned: no test for negative rows
            d = int(hamming(query_words[i], words[j]))
            if d < back_best[j]:
                back_best[j] = d
                back[j] = i
            if d < best:
                second = best
                best = d
                winner = int(j)
            elif d < second:
                second = d
        if best <= max_distance and best < ratio * second:
            matched[i] = winner
            distance[i] = best
    for i in range(n):
        if matched[i] >= 0:
            matched[i] = order[matched[i]] if back[matched[i]] == i else -1
    return matched, distance


@compiled
def best_near_segments(  # type: ignore[no-untyped-def]
    query, start, end, train, tolerance, margin, grid, max_distance, ratio
):
    """Search within `tolerance` (M,) of each train feature, at most `margin`, from segments."""
    train_xy, order, starts, columns = train.xy, grid.order, grid.starts, grid.columns
    query_words, train_words = query.words, train.words
    query_octave, train_octave = query.octave, train.octave
    count = len(query_words)
    matched = np.full(count, -1, dtype=np.int64)
    distance = np.full(count, 512, dtype=np.int64)
    for i in range(count):
        x, y = start[i, 0], start[i, 1]
        dx, dy = end[i, 0] - x, end[i, 1] - y
        length = np.sqrt(dx * dx + dy * dy)
        # A segment without length may have any direction.
        dx, dy = (dx / length, dy / length) if length > 1e-9 else (1.0, 0.0)
        first_row, last_row = _cells(y, y + length * dy, margin, grid.top, grid.rows)
        best, second, winner = 512, 512, -1
        for row in range(first_row, last_row + 1):
            top = row * _CELL_PX + grid.top - y
            near, far = _part(dy, length, margin, top, top + _CELL_PX)
            first, last = _cells(x + near * dx, x + far * dx, margin, grid.left, columns)
            for k in range(starts[row * columns + first], starts[row * columns + last + 1]):
                j = order[k]
                px, py = train_xy[j, 0] - x, train_xy[j, 1] - y
                along = px * dx + py * dy
                across = px * dy - py * dx
                t = tolerance[j]
                if across > t or across < -t or along < -t or along > length + t:
                    continue
                if abs(train_octave[j] - query_octave[i]) > 1:
                    continue
                d = int(hamming(query_words[i], train_words[j]))
                if d < best:
                    second = best
                    best = d
                    winner = j
                elif d < second:
                    second = d
                if d == best and j < winner:
                    winner = j
        if winner >= 0 and best <= max_distance and best < ratio * second:
            matched[i] = winner
            distance[i] = best
    return matched, distance


@compiled
def _cells(a, b, margin, origin, count):  # type: ignore[no-untyped-def]
    """First and last of `count` cells between a and b, with a margin on both sides."""
    low, high = (min(a, b) - margin - origin) / _CELL_PX, (max(a, b) + margin - origin) / _CELL_PX
    return int(min(max(low, 0.0), count)), int(max(min(high, count - 1.0), -1.0))


@compiled
def _part(slope, length, margin, top, bottom):  # type: ignore[no-untyped-def]
    """Range along a segment in which its neighbourhood may lie between two rows of pixels."""
    near, far = -margin, length + margin
    if abs(slope) > 1e-9:
        a, b = (top - margin) / slope, (bottom + margin) / slope
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far
