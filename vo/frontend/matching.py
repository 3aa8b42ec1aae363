"""Matching of binary features by Hamming distance, everywhere or inside search regions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo.compiling.function import NO_REFCOUNT, compiled
from vo.config import MatchingConfig
from vo.frontend.contracts import (
    Circles,
    DescriptorFormat,
    FeatureSet,
    Matches,
    SearchRegion,
)
from vo.types import Bools, Descriptors, Floats32, Ints

_CELL_PX = 32.0
_ROUNDING_PX = 1e-3  # added to tolerances where whole cells are skipped
_ANGLE_BINS = 30
_ANGLE_BINS_KEPT = 3
NO_MATCH = -1

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


def as_words(descriptor: Descriptors) -> NDArray[np.uint64]:
    """(N, 32) uint8 descriptors as (N, 4) words."""
    return np.ascontiguousarray(descriptor).view(np.uint64).reshape(-1, 4)


class HammingMatcher:
    """Matches binary descriptors of 256 bits.

    A match is within the search region and at most one octave off, its Hamming distance is low,
    clearly lower than the second best (ratio test, Lowe 2004), and it is the best query of its
    train feature.
    """

    descriptor_format = DescriptorFormat(32, np.dtype(np.uint8))

    def __init__(self, config: MatchingConfig) -> None:
        self._config = config

    def match(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion = None,
        *,
        ratio: float | None = None,
        check_rotation: bool = True,
    ) -> Matches:
        """One-to-one matches, see `vo.frontend.contracts.Matcher`.

        Raises:
            ValueError: descriptors are not (N, 32) uint8.
        """
        self.descriptor_format.check(query.descriptor)
        self.descriptor_format.check(train.descriptor)
        if len(query) == 0 or len(train) == 0:
            return Matches(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
        limits = self._config.max_hamming, self._config.ratio if ratio is None else ratio
        matched, distance = self._nearest(query, train, region, *limits)
        matched = _one_to_one(matched, distance, len(train))
        rows = np.flatnonzero(matched >= 0)
        matches = Matches(rows, matched[rows], distance[rows].astype(np.float64))
        return with_common_rotation(matches, query, train) if check_rotation else matches

    def _nearest(
        self,
        query: FeatureSet,
        train: FeatureSet,
        region: SearchRegion,
        max_distance: int,
        ratio: float,
    ) -> tuple[Ints, Ints]:
        """Row of the best train feature of each query (N,), -1 for none, and its distance."""
        query_words, train_words = as_words(query.descriptor), as_words(train.descriptor)
        if region is None:
            nearest, distance = _best_of_all(query_words, train_words, max_distance, ratio)
            return nearest, distance
        train_xy = np.ascontiguousarray(train.xy, dtype=np.float64)
        order, starts, columns, rows, origin = _grid(train_xy, _CELL_PX)
        if isinstance(region, Circles):
            nearest, distance = _best_in_windows(
                np.ascontiguousarray(query.xy, dtype=np.float64),
                query.octave,
                query_words,
                np.ascontiguousarray(region.radius_px, dtype=np.float64),
                train_xy,
                train.octave,
                train_words,
                order,
                starts,
                columns,
                rows,
                origin,
                max_distance,
                ratio,
            )
            return nearest, distance
        tolerance_px = np.ascontiguousarray(region.tolerance_px, dtype=np.float64)
        nearest, distance = _best_near_segments(
            query.octave,
            query_words,
            train_xy,
            train.octave,
            train_words,
            order,
            starts,
            columns,
            rows,
            origin,
            np.ascontiguousarray(region.start, dtype=np.float64),
            np.ascontiguousarray(region.end, dtype=np.float64),
            tolerance_px,
            float(tolerance_px.max()) + _ROUNDING_PX,
            max_distance,
            ratio,
        )
        return nearest, distance


def with_common_rotation(matches: Matches, query: FeatureSet, train: FeatureSet) -> Matches:
    """The matches whose change of orientation is a common one; all where features have none."""
    before, after = query.angle[matches.query], train.angle[matches.train]
    if np.isnan(before).any() or np.isnan(after).any():
        return matches
    kept = agree_in_rotation(before, after)
    return Matches(matches.query[kept], matches.train[kept], matches.score[kept])


def agree_in_rotation(query_angle: Floats32, train_angle: Floats32) -> Bools:
    """Mask of the matches (N,) whose change of orientation is a common one.

    A turn of the camera turns all features alike; the three fullest bins of a histogram of the
    changes are kept (Mur-Artal et al., ORB-SLAM, 2015), each with its two neighbours' halves.
    """
    if len(query_angle) == 0:
        return np.zeros(0, dtype=bool)
    return np.asarray(_agree(query_angle, train_angle))


@compiled
def _agree(query_angle, train_angle):  # type: ignore[no-untyped-def]
    bins, counts = np.empty(len(query_angle), dtype=np.int64), np.zeros(_ANGLE_BINS, dtype=np.int64)
    for n in range(len(bins)):
        turn = np.float64(train_angle[n]) - np.float64(query_angle[n])
        bins[n] = int(np.floor(turn * (_ANGLE_BINS / (2.0 * np.pi)) + 0.5)) % _ANGLE_BINS
        counts[bins[n]] += 1
    enough = 0.1 * counts[_fullest(counts)]
    is_kept = np.zeros(_ANGLE_BINS, dtype=np.bool_)
    for _ in range(_ANGLE_BINS_KEPT):
        bin = _fullest(counts)
        is_kept[bin] = counts[bin] >= enough
        counts[bin] = -1
    agrees = np.empty(len(bins), dtype=np.bool_)
    for n in range(len(bins)):
        agrees[n] = is_kept[bins[n]]
    return agrees


@compiled(**NO_REFCOUNT)
def _fullest(counts):  # type: ignore[no-untyped-def]
    """Index of the highest count, the first of equals."""
    fullest = 0
    for bin in range(len(counts)):
        if counts[bin] > counts[fullest]:
            fullest = bin
    return fullest


@compiled
def _one_to_one(matched, distance, count):  # type: ignore[no-untyped-def]
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
def _grid(xy, cell):  # type: ignore[no-untyped-def]
    """Rows sorted by grid cell, and where each cell begins."""
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
    return order, starts, columns, rows, (left, top)


@compiled
def _best_in_windows(  # type: ignore[no-untyped-def]
    query_xy,
    query_octave,
    query_words,
    radius,
    train_xy,
    train_octave,
    train_words,
    order,
    starts,
    columns,
    rows,
    origin,
    max_distance,
    ratio,
):
    count = len(query_xy)
    matched = np.full(count, -1, dtype=np.int64)
    distance = np.full(count, 512, dtype=np.int64)
    for i in range(count):
        x, y, r = query_xy[i, 0] - origin[0], query_xy[i, 1] - origin[1], radius[i]
        first_column = max(int(np.floor((x - r) / _CELL_PX)), 0)
        last_column = min(int(np.floor((x + r) / _CELL_PX)), columns - 1)
        first_row = max(int(np.floor((y - r) / _CELL_PX)), 0)
        last_row = min(int(np.floor((y + r) / _CELL_PX)), rows - 1)
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
def _best_of_all(query_words, train_words, max_distance, ratio):  # type: ignore[no-untyped-def]
    n, m = len(query_words), len(train_words)
    matched = np.full(n, -1, dtype=np.int64)
    distance = np.full(n, 512, dtype=np.int64)
    back_best = np.full(m, 512, dtype=np.int64)
    back = np.full(m, -1, dtype=np.int64)
    for i in range(n):
        best, second, winner = 512, 512, -1
        for j in range(m):
            d = int(hamming(query_words[i], train_words[j]))
            if d < back_best[j]:
                back_best[j] = d
                back[j] = i
            if d < best:
                second = best
                best = d
                winner = j
            elif d < second:
                second = d
        if best <= max_distance and best < ratio * second:
            matched[i] = winner
            distance[i] = best
    for i in range(n):
        if matched[i] >= 0 and back[matched[i]] != i:
            matched[i] = -1
    return matched, distance


@compiled
def _best_near_segments(  # type: ignore[no-untyped-def]
    query_octave,
    query_words,
    train_xy,
    train_octave,
    train_words,
    order,
    starts,
    columns,
    rows,
    origin,
    start,
    end,
    tolerance,
    margin,
    max_distance,
    ratio,
):
    count = len(query_words)
    matched = np.full(count, -1, dtype=np.int64)
    distance = np.full(count, 512, dtype=np.int64)
    for i in range(count):
        x, y = start[i, 0], start[i, 1]
        dx, dy = end[i, 0] - x, end[i, 1] - y
        length = np.sqrt(dx * dx + dy * dy)
        # Of a segment without length any direction will do.
        dx, dy = (dx / length, dy / length) if length > 1e-9 else (1.0, 0.0)
        first_row, last_row = _cells(y, y + length * dy, margin, origin[1], rows)
        best, second, winner = 512, 512, -1
        for row in range(first_row, last_row + 1):
            top = row * _CELL_PX + origin[1] - y
            near, far = _part(dy, length, margin, top, top + _CELL_PX)
            first, last = _cells(x + near * dx, x + far * dx, margin, origin[0], columns)
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
    """First and last cell, of those there are, that hold what lies between a and b or near."""
    low, high = (min(a, b) - margin - origin) / _CELL_PX, (max(a, b) + margin - origin) / _CELL_PX
    return int(min(max(low, 0.0), count)), int(max(min(high, count - 1.0), -1.0))


@compiled
def _part(slope, length, margin, top, bottom):  # type: ignore[no-untyped-def]
    """From where to where along a segment its neighbourhood may lie in a band of rows."""
    near, far = -margin, length + margin
    if abs(slope) > 1e-9:
        a, b = (top - margin) / slope, (bottom + margin) / slope
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far
