"""Matchers against exhaustive search, on descriptors with known partners."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.config import MatchingConfig
from vo.base.types import Descriptors, Floats
from vo.engine.features.matching import (
    DescriptorMatcher,
    distances,
    grid_motion_consistent,
    make_matcher,
)
from vo.engine.features.opencv import find
from vo.engine.frontend.contracts import Circles, DescriptorFormat, EpipolarSegments, FeatureSet
from vo.engine.frontend.matching import HammingMatcher

COUNT = 300


def descriptors(dtype: str, width: int) -> tuple[Descriptors, Descriptors]:
    """Two arrays; row i of the second is a noisy copy of row i of the first."""
    noise = np.random.default_rng(0)
    if dtype == "uint8":
        first = noise.integers(0, 256, (COUNT, width), dtype=np.uint8)
        flips = np.packbits(noise.random((COUNT, width * 8)) < 0.06, axis=1)
        return first, first ^ flips
    first_floats = noise.random((COUNT, width), dtype=np.float32)
    return first_floats, first_floats + noise.normal(0, 0.02, (COUNT, width)).astype(np.float32)


def features(descriptor: Descriptors, xy: Floats | None = None) -> FeatureSet:
    count = len(descriptor)
    return FeatureSet(xy, np.zeros(count, np.int32), np.full(count, np.nan, np.float32), descriptor)


LAYOUTS = [("uint8", 32), ("uint8", 61), ("uint8", 64), ("float32", 128), ("float32", 64)]


@pytest.mark.parametrize(("dtype", "width"), LAYOUTS)
@pytest.mark.parametrize("method", ["brute_force", "flann", "ann"])
@pytest.mark.parametrize("cross_check", [False, True])
def test_partners_are_found(dtype: str, width: int, method: str, cross_check: bool) -> None:
    query, train = descriptors(dtype, width)
    order = np.random.default_rng(1).permutation(COUNT)
    config = MatchingConfig(method=method, cross_check=cross_check)
    found = DescriptorMatcher(config).match(features(query), features(train[order]))
    assert len(found.query) > (0.99 if method == "brute_force" else 0.75) * COUNT
    np.testing.assert_array_equal(order[found.train], found.query)
    assert (np.diff(found.query) > 0).all()
    assert len(set(found.train.tolist())) == len(found.train)
    again = DescriptorMatcher(config).match(features(query), features(train[order]))
    for one, other in zip(found, again, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("width", [64, 61, 3])
def test_distances_of_pairs_are_euclidean(width: int) -> None:
    query, train = descriptors("float32", width)
    q, t = np.array([0, 5, 5, 299]), np.array([7, 5, 0, 1])
    expected = np.linalg.norm(query[q].astype(np.float64) - train[t], axis=1)
    np.testing.assert_allclose(distances(query, train, q, t), expected, rtol=1e-6)
    assert len(distances(query, train, q[:0], t[:0])) == 0


def test_the_ratio_test_drops_what_has_a_double() -> None:
    query, train = descriptors("float32", 64)
    doubled = np.concatenate([train, train[:50] + np.float32(1e-3)])
    found = DescriptorMatcher(MatchingConfig(method="brute_force")).match(
        features(query), features(doubled)
    )
    np.testing.assert_array_equal(found.query, np.arange(50, COUNT))
    every = DescriptorMatcher(MatchingConfig(method="brute_force", ratio=1.0)).match(
        features(query), features(doubled)
    )
    assert len(every.query) == COUNT


def test_a_cross_check_drops_one_sided_matches() -> None:
    query, train = descriptors("uint8", 32)
    config = MatchingConfig(method="brute_force", ratio=1.0, cross_check=False)
    without = DescriptorMatcher(config).match(features(query), features(train[:100]))
    config = MatchingConfig(method="brute_force", ratio=1.0, cross_check=True)
    checked = DescriptorMatcher(config).match(features(query), features(train[:100]))
    assert set(checked.query.tolist()) <= set(without.query.tolist())
    np.testing.assert_array_equal(checked.query, np.arange(100))


def expected_in_circles(
    query: FeatureSet, train: FeatureSet, radius_px: Floats, distance: Floats, ratio: float
) -> dict[int, int]:
    assert query.xy is not None and train.xy is not None
    away = np.linalg.norm(query.xy[:, None] - train.xy[None], axis=2)
    allowed = away <= radius_px[:, None]
    allowed &= np.abs(query.octave[:, None] - train.octave[None]) <= 1
    distance = np.where(allowed, distance, np.inf)
    best = np.argmin(distance, axis=1)
    first, second = np.sort(distance, axis=1)[:, :2].T
    chosen: dict[int, int] = {}
    for q in np.argsort(first, kind="stable"):
        if np.isfinite(first[q]) and first[q] < ratio * second[q]:
            chosen.setdefault(int(best[q]), int(q))
    return {q: t for t, q in chosen.items()}


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_a_search_in_circles_is_an_exhaustive_one(dtype: str) -> None:
    noise = np.random.default_rng(3)
    query_descriptor, train_descriptor = descriptors(dtype, 32)
    xy = noise.uniform(0, 600, (COUNT, 2))
    octave = noise.integers(0, 4, COUNT).astype(np.int32)
    angle = np.full(COUNT, np.nan, np.float32)
    query = FeatureSet(xy + noise.normal(0, 5, xy.shape), octave, angle, query_descriptor)
    train = FeatureSet(xy, octave, angle, train_descriptor)
    radius_px = noise.uniform(0, 80, COUNT)
    if dtype == "uint8":
        bits = [np.unpackbits(d, axis=1).astype(int) for d in (query_descriptor, train_descriptor)]
        distance = np.abs(bits[0][:, None] - bits[1][None]).sum(axis=2).astype(float)
        distance[distance > 0.3 * 256] = np.inf
    else:
        distance = np.linalg.norm(
            query_descriptor[:, None].astype(float) - train_descriptor[None], axis=2
        )
    found = DescriptorMatcher(MatchingConfig()).match(query, train, Circles(radius_px))
    expected = expected_in_circles(query, train, radius_px, distance, 0.85)
    if dtype == "float32":
        assert dict(zip(found.query.tolist(), found.train.tolist(), strict=True)) == expected
    else:  # the second nearest may be one that the limit on bits left out here
        assert set(found.query.tolist()) <= set(expected)
        assert len(found.query) > 0.9 * len(expected)


def test_a_search_near_segments_finds_what_lies_there() -> None:
    query_descriptor, train_descriptor = descriptors("float32", 64)
    noise = np.random.default_rng(4)
    start = noise.uniform(0, 300, (COUNT, 2))
    end = start + noise.uniform(-200, 200, (COUNT, 2))
    along = noise.uniform(0, 1, (COUNT, 1))
    across = np.stack([-(end - start)[:, 1], (end - start)[:, 0]], axis=1)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    away = np.where(np.arange(COUNT) % 2 == 0, 1.5, 3.0)[:, None]  # every second one too far
    xy = start + along * (end - start) + away * across
    region = EpipolarSegments(start, end, np.full(COUNT, 2.0))
    found = DescriptorMatcher(MatchingConfig(ratio=1.0)).match(
        features(query_descriptor), features(train_descriptor, xy), region
    )
    right = found.query == found.train
    assert set(found.query[right].tolist()) == set(range(0, COUNT, 2))


def test_the_default_is_the_matcher_of_orb_and_others_get_one_that_fits() -> None:
    class Extractor:
        def __init__(self, width: int, dtype: type) -> None:
            self.descriptor_format = DescriptorFormat(width, np.dtype(dtype))

    default = make_matcher(MatchingConfig(), Extractor(32, np.uint8))  # type: ignore[arg-type]
    assert isinstance(default, HammingMatcher)
    for width, dtype in ((128, np.float32), (64, np.uint8)):
        other = make_matcher(MatchingConfig(), Extractor(width, dtype))  # type: ignore[arg-type]
        assert isinstance(other, DescriptorMatcher)
    with pytest.raises(ValueError, match="300 x 32 of uint8 and 300 x 64 of float32"):
        DescriptorMatcher(MatchingConfig()).match(
            features(descriptors("uint8", 32)[0]), features(descriptors("float32", 64)[0])
        )


def test_few_and_no_descriptors() -> None:
    query, train = descriptors("float32", 64)
    for method in ("brute_force", "flann", "ann"):
        matcher = DescriptorMatcher(MatchingConfig(method=method))
        assert len(matcher.match(features(query[:0]), features(train)).query) == 0
        assert len(matcher.match(features(query), features(train[:0])).query) == 0
        one = matcher.match(features(query), features(train[:1]))
        assert one.query.tolist() in ([], [0])


@pytest.mark.skipif(find("matchGMS") is None, reason="needs opencv-contrib-python-headless")
def test_grid_motion_statistics_keep_what_neighbours_support() -> None:
    noise = np.random.default_rng(5)
    xy = noise.uniform(0, 640, (2000, 2)).astype(np.float32) * [1, 0.75]
    moved = xy + [12, 5]
    wrong = noise.random(2000) < 0.4
    moved[wrong] = noise.uniform(0, 480, (int(wrong.sum()), 2))
    rows = np.arange(2000)
    from vo.engine.frontend.contracts import Matches

    kept = grid_motion_consistent(
        Matches(rows, rows, np.zeros(2000)), xy, moved.astype(np.float32), ((640, 480),) * 2
    )
    assert (~wrong[kept.query]).mean() > 0.95
