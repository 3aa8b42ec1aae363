"""Matching along segments by cells against the plain search through all features."""

from __future__ import annotations

import numpy as np
import pytest
from matched_rows import match_segments
from numpy.typing import NDArray

from vo.base.types import Bytes, Floats, Ints
from vo.engine.frontend.hamming_kernels import NO_MATCH

Ints32 = NDArray[np.int32]

KINDS = ["slanted", "rows", "columns", "far away", "huge"]


def _segments(kind: str, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    start = rng.uniform((-50, -50), (700, 450), (count, 2))
    reach = {
        "slanted": rng.uniform(-200, 200, (count, 2)),
        "rows": rng.uniform(-200, 200, (count, 2)) * (1, 0),
        "columns": rng.uniform(-200, 200, (count, 2)) * (0, 1),
        "far away": rng.uniform(3000, 4000, (count, 2)),
        "huge": rng.uniform(-1e7, 1e7, (count, 2)),
    }
    return start + (3000 if kind == "far away" else 0), start + reach[kind]


def _plain(
    query_octave: Ints32,
    query: Bytes,
    xy: Floats,
    train_octave: Ints32,
    train: Bytes,
    start: Floats,
    end: Floats,
    tolerance: Floats,
) -> Ints:
    """The definition, written with numpy."""
    chosen: dict[int, tuple[int, int]] = {}  # distance and query of each train feature
    for i, (a, b) in enumerate(zip(start, end, strict=True)):
        length = max(float(np.linalg.norm(b - a)), 1e-9)
        along = (xy - a) @ (b - a) / length
        across = (xy - a) @ ((b - a)[::-1] * (1, -1)) / length
        near = (np.abs(across) <= tolerance) & (along >= -tolerance)
        near &= (along <= length + tolerance) & (np.abs(train_octave - query_octave[i]) <= 1)
        rows = np.flatnonzero(near)
        if len(rows) == 0:
            continue
        distance = np.bitwise_count(train[rows] ^ query[i]).sum(axis=1, dtype=np.int64)
        best, *others = np.argsort(distance, kind="stable")[:2].tolist()
        second = int(distance[others[0]]) if others else 512
        d, j = int(distance[best]), int(rows[best])
        if d <= 64 and d < 0.9 * second and (d, i) < chosen.get(j, (512, 0)):
            chosen[j] = (d, i)
    result = np.full(len(query), NO_MATCH)
    for j, (_, i) in chosen.items():
        result[i] = j
    return result


def _both(
    query: Bytes, train: Bytes, xy: Floats, start: Floats, end: Floats, rng: np.random.Generator
) -> tuple[Ints, Ints]:
    query_octave = rng.integers(0, 4, len(query)).astype(np.int32)
    train_octave = rng.integers(0, 4, len(train)).astype(np.int32)
    tolerance = 1.5 * 1.44 ** train_octave.astype(np.float64)
    shared = (query_octave, query, xy, train_octave, train, start, end)
    plain = _plain(*shared, tolerance)
    cells = match_segments(*shared, tolerance_px=tolerance, max_distance=64, ratio=0.9)
    return plain, cells


@pytest.mark.parametrize("kind", KINDS)
def test_cells_change_no_match(kind: str) -> None:
    rng = np.random.default_rng(KINDS.index(kind))
    # Few descriptors for many features, on whole pixels: equal distances must be settled alike.
    base = rng.integers(0, 256, (40, 32), dtype=np.uint8)
    query = base[rng.integers(0, 40, 600)]
    train = base[rng.integers(0, 40, 1500)] ^ (rng.random((1500, 32)) < 0.05).astype(np.uint8)
    xy = rng.integers((0, 0), (640, 400), (1500, 2)).astype(np.float64)
    start, end = _segments(kind, rng, 600)
    plain, cells = _both(query, train, xy, start, end, rng)
    np.testing.assert_array_equal(cells, plain)
    if kind != "far away":
        assert np.mean(plain >= 0) > 0.02


def test_one_feature_is_matched_and_none_are_not() -> None:
    rng = np.random.default_rng(0)
    descriptor = rng.integers(0, 256, (1, 32), dtype=np.uint8)
    at, octave = np.array([[30.0, 40.0]]), np.zeros(1, np.int32)
    none = np.empty((0, 2))

    def match(xy: Floats, train: Bytes) -> list[int]:
        levels = np.zeros(len(train), np.int32)
        tolerance = np.full(len(train), 2.0)
        return match_segments(
            octave, descriptor, xy, levels, train, at - 5.0, at + 5.0,
            tolerance_px=tolerance, max_distance=64, ratio=0.9,
        ).tolist()  # fmt: skip

    assert match(at, descriptor) == [0]
    assert match(none, descriptor[:0]) == [-1]


@pytest.mark.parametrize(
    ("x", "y", "found"), [(31.9, 41.9, True), (32.1, 40, False), (30, 37.9, False)]
)
def test_a_segment_without_length_is_a_point(x: float, y: float, found: bool) -> None:
    descriptor = np.random.default_rng(0).integers(0, 256, (1, 32), dtype=np.uint8)
    at, octave = np.array([[30.0, 40.0]]), np.zeros(1, np.int32)
    matched = match_segments(
        octave, descriptor, np.array([[x, y]]), octave, descriptor, at, at,
        tolerance_px=np.full(1, 2.0), max_distance=64, ratio=0.9,
    )  # fmt: skip
    assert (matched == [0]).all() == found
