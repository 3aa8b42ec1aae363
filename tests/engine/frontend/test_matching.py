from __future__ import annotations

import numpy as np
import pytest
from matched_rows import match_everywhere, match_segments, match_windows

from vo.base.types import Bytes, Floats, Ints
from vo.engine.frontend.hamming_kernels import NO_MATCH
from vo.engine.frontend.matching import agree_in_rotation


def _random(rng: np.random.Generator, count: int) -> Bytes:
    return rng.integers(0, 256, (count, 32), dtype=np.uint8)


def _with_flips(descriptor: Bytes, flips: int) -> Bytes:
    """The same with the first `flips` bits turned over."""
    mask = np.packbits(np.arange(256) < flips)
    return np.asarray(descriptor ^ mask, dtype=np.uint8)


def _distances(query: Bytes, train: Bytes) -> Ints:
    return np.bitwise_count(query[:, None] ^ train[None]).sum(axis=2, dtype=np.int64)


def _zeros(count: int) -> np.ndarray:
    return np.zeros(count, np.int32)


def _windows(
    query_xy: Floats,
    query: Bytes,
    train_xy: Floats,
    train: Bytes,
    *,
    radius: float = 10.0,
    query_octave: list[int] | None = None,
    train_octave: list[int] | None = None,
    ratio: float = 0.85,
) -> list[int]:
    return match_windows(
        np.asarray(query_xy, dtype=np.float64).reshape(-1, 2),
        _zeros(len(query)) if query_octave is None else np.array(query_octave, np.int32),
        query,
        np.full(len(query), radius),
        np.asarray(train_xy, dtype=np.float64).reshape(-1, 2),
        _zeros(len(train)) if train_octave is None else np.array(train_octave, np.int32),
        train,
        max_distance=64,
        ratio=ratio,
    ).tolist()


def test_distance_is_the_number_of_differing_bits() -> None:
    rng = np.random.default_rng(0)
    for mask in (0, 1, 128, 200, 255):
        query = _random(rng, 1)
        train = query ^ (_random(rng, 1) & np.uint8(mask))
        bits = int(_distances(query, train)[0, 0])
        for limit in (bits - 1, bits):
            found = match_everywhere(query, train, max_distance=limit, ratio=0.9)
            assert (found.tolist() == [0]) == (limit == bits)


# Windows


def test_windows_find_all_planted_matches() -> None:
    rng = np.random.default_rng(1)
    count = 300
    xy = rng.uniform((-50, 20), (900, 400), (count, 2))
    order = rng.permutation(count)
    query, train = _random(rng, count), np.empty((count, 32), np.uint8)
    train_xy = np.empty((count, 2))
    train[order] = _with_flips(query, 20)
    train_xy[order] = xy + rng.uniform(-6, 6, (count, 2))
    assert _windows(xy, query, train_xy, train) == order.tolist()


def test_windows_are_round_and_end_at_the_radius() -> None:
    query = _random(np.random.default_rng(2), 1)
    for offset, found in (((9.9, 0), True), ((10.1, 0), False), ((8, 8), False), ((0, -9.9), True)):
        at = np.array([100.0, 100.0])
        matched = _windows(at, query, at + offset, query)
        assert (matched == [0]) == found, offset


def test_each_query_has_its_own_radius() -> None:
    query = _random(np.random.default_rng(3), 2)
    xy = np.array([[0.0, 0.0], [500.0, 0.0]])
    matched = match_windows(
        xy,
        _zeros(2),
        query,
        np.array([5.0, 50.0]),
        xy + (20.0, 0.0),
        _zeros(2),
        query,
        max_distance=64,
        ratio=0.85,
    )
    assert matched.tolist() == [NO_MATCH, 1]


@pytest.mark.parametrize(
    ("octave", "found"), [(1, False), (2, True), (3, True), (4, True), (5, False)]
)
def test_windows_allow_one_octave_of_difference(octave: int, found: bool) -> None:
    query = _random(np.random.default_rng(4), 1)
    at = np.array([10.0, 10.0])
    matched = _windows(at, query, at, query, query_octave=[3], train_octave=[octave])
    assert (matched == [0]) == (2 <= octave <= 4)


@pytest.mark.parametrize(("second", "found"), [(10, False), (11, False), (12, False), (13, True)])
def test_the_second_best_must_be_clearly_worse(second: int, found: bool) -> None:
    query = _random(np.random.default_rng(5), 1)
    train = np.concatenate([_with_flips(query, second), _with_flips(query, 10)])
    at = np.zeros((1, 2))
    matched = _windows(at, query, np.zeros((2, 2)), train, ratio=0.8)
    assert (matched == [1]) == found


@pytest.mark.parametrize(("flips", "found"), [(64, True), (65, False)])
def test_matches_differ_in_no_more_than_the_allowed_bits(flips: int, found: bool) -> None:
    query = _random(np.random.default_rng(6), 1)
    at = np.zeros((1, 2))
    assert (_windows(at, query, at, _with_flips(query, flips)) == [0]) == found


def test_two_queries_never_share_a_train_feature() -> None:
    train = _random(np.random.default_rng(7), 1)
    query = np.concatenate([_with_flips(train, 9), _with_flips(train, 4), _with_flips(train, 7)])
    at = np.zeros((3, 2))
    assert _windows(at, query, at[:1], train) == [NO_MATCH, 0, NO_MATCH]


def test_windows_without_features_match_nothing() -> None:
    rng = np.random.default_rng(8)
    none, some = np.empty((0, 32), np.uint8), _random(rng, 3)
    assert _windows(np.empty((0, 2)), none, np.zeros((3, 2)), some) == []
    assert _windows(np.zeros((3, 2)), some, np.empty((0, 2)), none) == [NO_MATCH] * 3


# Everywhere


def _mutual_best(query: Bytes, train: Bytes, max_distance: int, ratio: float) -> list[int]:
    """The definition, written with numpy."""
    distance = _distances(query, train)
    result = np.full(len(query), NO_MATCH)
    back = np.argmin(distance, axis=0)
    for i, row in enumerate(distance):
        order = np.argsort(row, kind="stable")
        second = row[order[1]] if len(row) > 1 else 512
        best = order[0]
        if row[best] <= max_distance and row[best] < ratio * second and back[best] == i:
            result[i] = best
    return result.tolist()


@pytest.mark.parametrize("seed", range(20))
def test_everywhere_gives_what_brute_force_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = _random(rng, 15)
    noise = np.packbits(rng.random((80, 256)) < rng.uniform(0, 0.2), axis=1)
    query = base[rng.integers(0, 15, 80)] ^ noise
    train = base[rng.integers(0, 15, int(rng.integers(1, 60)))]
    train = train ^ np.packbits(rng.random((len(train), 256)) < rng.uniform(0, 0.2), axis=1)
    found = match_everywhere(query, train, max_distance=64, ratio=0.9)
    assert found.tolist() == _mutual_best(query, train, 64, 0.9)


def test_everywhere_without_features_matches_nothing() -> None:
    none, some = np.empty((0, 32), np.uint8), _random(np.random.default_rng(9), 3)
    assert match_everywhere(none, some, max_distance=64, ratio=0.9).tolist() == []
    assert match_everywhere(some, none, max_distance=64, ratio=0.9).tolist() == [NO_MATCH] * 3


# Epipolar


def _epipolar(
    query: Bytes,
    train_xy: Floats,
    train: Bytes,
    start: Floats,
    end: Floats,
    *,
    tolerance: float = 2.0,
    train_octave: list[int] | None = None,
) -> list[int]:
    return match_segments(
        _zeros(len(query)),
        query,
        np.asarray(train_xy, dtype=np.float64).reshape(-1, 2),
        _zeros(len(train)) if train_octave is None else np.array(train_octave, np.int32),
        train,
        np.asarray(start, dtype=np.float64).reshape(-1, 2),
        np.asarray(end, dtype=np.float64).reshape(-1, 2),
        tolerance_px=np.full(len(train), tolerance),
        max_distance=64,
        ratio=0.85,
    ).tolist()


def test_epipolar_search_finds_matches_on_their_segments_only() -> None:
    rng = np.random.default_rng(10)
    count = 200
    start = rng.uniform(0, 500, (count, 2))
    end = start + rng.uniform(-100, 100, (count, 2))
    train_xy = start + rng.uniform(0, 1, (count, 1)) * (end - start)
    query = _random(rng, count)
    train = _with_flips(query, 15)
    assert _epipolar(query, train_xy, train, start, end) == list(range(count))
    direction = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    beside = train_xy + 2.5 * direction[:, ::-1] * (1, -1)
    assert _epipolar(query, beside, train, start, end) == [NO_MATCH] * count


@pytest.mark.parametrize(
    ("x", "y", "found"),
    [(50, 1.9, True), (50, -1.9, True), (50, 2.1, False), (-1.9, 0, True), (-2.1, 0, False)]
    + [(101.9, 0, True), (102.1, 0, False)],
)
def test_the_tolerance_reaches_across_and_past_both_ends(x: float, y: float, found: bool) -> None:
    query = _random(np.random.default_rng(11), 1)
    at, start, end = np.array([x, y]), np.zeros(2), np.array([100.0, 0.0])
    assert (_epipolar(query, at, query, start, end) == [0]) == found


def test_epipolar_search_works_on_a_segment_without_length() -> None:
    query = _random(np.random.default_rng(12), 1)
    at = np.array([30.0, 40.0])
    assert _epipolar(query, at + (1.0, 0.5), query, at, at) == [0]


def test_epipolar_search_checks_octave_and_is_one_to_one() -> None:
    train = _random(np.random.default_rng(13), 1)
    query = np.concatenate([_with_flips(train, 8), _with_flips(train, 3)])
    start, end = np.zeros((2, 2)), np.tile([[10.0, 0.0]], (2, 1))
    at = np.array([5.0, 0.0])
    assert _epipolar(query, at, train, start, end) == [NO_MATCH, 0]
    assert _epipolar(query, at, train, start, end, train_octave=[2]) == [NO_MATCH] * 2


def test_epipolar_search_without_features_matches_nothing() -> None:
    none, some = np.empty((0, 32), np.uint8), _random(np.random.default_rng(14), 2)
    nowhere = np.empty((0, 2))
    assert _epipolar(none, np.zeros((2, 2)), some, nowhere, nowhere) == []
    assert _epipolar(some, nowhere, none, np.zeros((2, 2)), np.ones((2, 2))) == [NO_MATCH] * 2


# Rotation


def test_matches_that_turn_with_most_others_are_kept() -> None:
    rng = np.random.default_rng(15)
    query = rng.uniform(-np.pi, np.pi, 300)
    turn = 0.6 + rng.normal(0, 0.05, 300)
    turn[:60] = rng.uniform(0, 2 * np.pi, 60)
    train = np.angle(np.exp(1j * (query + turn)))
    kept = agree_in_rotation(query.astype(np.float32), train.astype(np.float32))
    assert kept[60:].mean() > 0.97
    assert kept[:60].mean() < 0.3


@pytest.mark.parametrize("turn", [0.0, np.pi, -np.pi, 2 * np.pi - 1e-4, 1e-4])
def test_a_common_turn_is_kept_wherever_angles_wrap(turn: float) -> None:
    query = np.linspace(-np.pi, np.pi, 50).astype(np.float32)
    train = np.angle(np.exp(1j * (query.astype(np.float64) + turn))).astype(np.float32)
    assert agree_in_rotation(query, train).all()


def test_no_matches_agree_on_nothing() -> None:
    none = np.empty(0, np.float32)
    assert agree_in_rotation(none, none).shape == (0,)
