"""Hamming matching as rows of the train features, -1 without a match."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo.base.config import MatchingConfig
from vo.base.types import Bytes, Floats, Floats32, Ints
from vo.engine.frontend.contracts import Circles, EpipolarSegments, FeatureSet, SearchRegion
from vo.engine.frontend.hamming_kernels import NO_MATCH
from vo.engine.frontend.matching import HammingMatcher

Ints32 = NDArray[np.int32]


def match_everywhere(query: Bytes, train: Bytes, *, max_distance: int, ratio: float) -> Ints:
    """Descriptors alone, (N, 32) each."""
    return _rows(_features(query), _features(train), None, max_distance, ratio)


def match_windows(
    query_xy: Floats,
    query_octave: Ints32,
    query: Bytes,
    radius_px: Floats,
    train_xy: Floats | Floats32,
    train_octave: Ints32,
    train: Bytes,
    *,
    max_distance: int,
    ratio: float,
) -> Ints:
    """Inside circles around the query's positions."""
    features = _features(query, query_octave, query_xy), _features(train, train_octave, train_xy)
    return _rows(*features, Circles(radius_px), max_distance, ratio)


def match_segments(
    query_octave: Ints32,
    query: Bytes,
    train_xy: Floats | Floats32,
    train_octave: Ints32,
    train: Bytes,
    start: Floats,
    end: Floats,
    *,
    tolerance_px: Floats,
    max_distance: int,
    ratio: float,
) -> Ints:
    """Near segments."""
    features = _features(query, query_octave), _features(train, train_octave, train_xy)
    return _rows(*features, EpipolarSegments(start, end, tolerance_px), max_distance, ratio)


def _features(
    descriptor: Bytes, octave: Ints32 | None = None, xy: Floats | Floats32 | None = None
) -> FeatureSet:
    count = len(descriptor)
    octave = np.zeros(count, np.int32) if octave is None else octave
    return FeatureSet(xy, octave, np.zeros(count, np.float32), descriptor)


def _rows(
    query: FeatureSet, train: FeatureSet, region: SearchRegion, max_distance: int, ratio: float
) -> Ints:
    config = MatchingConfig.model_construct(max_hamming=max_distance, ratio=ratio)
    matcher = HammingMatcher(config)
    matches = matcher.match(query, train, region, check_rotation=False)
    rows = np.full(len(query), NO_MATCH)
    rows[matches.query] = matches.train
    return rows
