"""Matching of binary features by Hamming distance, everywhere or inside search regions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.config import MatchingConfig
from vo.base.types import Bools, Descriptors, Floats32, Ints
from vo.engine.frontend import hamming_kernels
from vo.engine.frontend.contracts import (
    Circles,
    DescriptorFormat,
    FeatureSet,
    Matches,
    SearchRegion,
)
from vo.engine.frontend.hamming_kernels import PackedFeatures

_ROUNDING_PX = 1e-3  # added to tolerances where whole cells are skipped
_ANGLE_BINS = 30
_ANGLE_BINS_KEPT = 3


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
        """One-to-one matches, see `vo.engine.frontend.contracts.Matcher`.

        Raises:
            ValueError: descriptors are not (N, 32) uint8.
        """
        self.descriptor_format.check(query.descriptor)
        self.descriptor_format.check(train.descriptor)
        if len(query) == 0 or len(train) == 0:
            return Matches(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
        limits = self._config.max_hamming, self._config.ratio if ratio is None else ratio
        matched, distance = self._nearest(query, train, region, *limits)
        matched = hamming_kernels.one_to_one(matched, distance, len(train))
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
        if region is None:
            words = as_words(query.descriptor), as_words(train.descriptor)
            nearest, distance = hamming_kernels.best_of_all(*words, max_distance, ratio)
            return nearest, distance
        queries, trains = _packed(query), _packed(train)
        grid = hamming_kernels.make_grid(trains.xy)
        if isinstance(region, Circles):
            radius_px = np.ascontiguousarray(region.radius_px, dtype=np.float64)
            nearest, distance = hamming_kernels.best_in_circles(
                queries, radius_px, trains, grid, max_distance, ratio
            )
            return nearest, distance
        tolerance_px = np.ascontiguousarray(region.tolerance_px, dtype=np.float64)
        nearest, distance = hamming_kernels.best_near_segments(
            queries,
            np.ascontiguousarray(region.start, dtype=np.float64),
            np.ascontiguousarray(region.end, dtype=np.float64),
            trains,
            tolerance_px,
            float(tolerance_px.max()) + _ROUNDING_PX,
            grid,
            max_distance,
            ratio,
        )
        return nearest, distance


def _packed(features: FeatureSet) -> PackedFeatures:
    """Features for the kernels; positions that a region does not need are empty."""
    xy = np.empty((0, 2)) if features.xy is None else features.xy
    return PackedFeatures(
        np.ascontiguousarray(xy, dtype=np.float64), features.octave, as_words(features.descriptor)
    )


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
