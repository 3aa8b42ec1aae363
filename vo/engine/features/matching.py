"""Matching of descriptors of any type: exact or approximate, everywhere or in search regions."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import compiled
from vo.base.config import FeaturesConfig, MatchingConfig, MatchingName
from vo.base.errors import ConfigError
from vo.base.types import Descriptors, Floats, Floats32, Ints
from vo.engine.features.detectors import DETECTORS
from vo.engine.features.nearest import Nearest, make_search
from vo.engine.features.opencv import require_function
from vo.engine.frontend.contracts import (
    Circles,
    EpipolarSegments,
    FeatureExtractor,
    FeatureSet,
    Matcher,
    Matches,
    SearchRegion,
)
from vo.engine.frontend.hamming_kernels import make_grid
from vo.engine.frontend.matching import HammingMatcher, with_common_rotation

_LEARNED = ("lightglue", "lighterglue", "superglue")
_MARGIN_PX = 1e-3  # added to tolerances where whole cells are skipped
_MAX_BINARY = 0.3  # of the bits: unrelated descriptors differ in half of them


class _Candidates(NamedTuple):
    """Pairs of rows inside the search region, by query, then by train."""

    query: Ints
    train: Ints


class DescriptorMatcher:
    """Matches descriptors by Hamming or Euclidean distance.

    A match is within the search region and at most one octave off, clearly nearer than the second
    (ratio test, Lowe 2004), and, with `cross_check`, the nearest in both directions.
    """

    def __init__(self, config: MatchingConfig) -> None:
        self._config = config
        self._search = make_search(config.method)

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
            ValueError: descriptors of two layouts.
        """
        _check_alike(query.descriptor, train.descriptor)
        if len(query) == 0 or len(train) == 0:
            return Matches(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
        limit = self._config.ratio if ratio is None else ratio
        if self._config.method == "mnn":
            limit = 1.0
        if region is None:
            nearest = self._search(query.descriptor, train.descriptor)
            back = (
                self._search(train.descriptor, query.descriptor)
                if self._config.cross_check
                else None
            )
        else:
            candidates = _candidates(query, train, region)
            distance = distances(query.descriptor, train.descriptor, *candidates)
            nearest = Nearest(*_two_nearest(*candidates, distance, len(query)))
            back = None
        good = (nearest.row >= 0) & (nearest.distance <= limit * nearest.second)
        good &= nearest.distance <= _max_distance(query.descriptor)
        if back is not None:
            good &= back.row[np.maximum(nearest.row, 0)] == np.arange(len(query))
        rows = _one_to_one(np.flatnonzero(good), nearest)
        matches = Matches(rows, nearest.row[rows], nearest.distance[rows])
        return with_common_rotation(matches, query, train) if check_rotation else matches


def make_matcher(
    config: MatchingConfig, extractor: FeatureExtractor, features: FeaturesConfig | None = None
) -> Matcher:
    """The matcher for an extractor's descriptors that the settings name.

    `features`: settings that the extractor was made from, None for one of the caller's own.

    Raises:
        ConfigError: the matcher is made for other features, or its program is not installed.
        ModelError: its model has not been fetched.
    """
    if config.method in _LEARNED:
        return _learned_matcher(config, features)
    method = method_of(config, extractor)
    is_default = extractor.descriptor_format == HammingMatcher.descriptor_format
    if config.method == "auto" and method != "mnn" and config.cross_check and is_default:
        return HammingMatcher(config)
    return DescriptorMatcher(config.model_copy(update={"method": method}))


def _learned_matcher(config: MatchingConfig, features: FeaturesConfig | None) -> Matcher:
    """A network where nothing is predicted, for the features that it was trained with."""
    from vo.engine.learned import lightglue, superglue
    from vo.engine.learned.catalog import find_model
    from vo.engine.learned.files import require_model
    from vo.engine.learned.inference import load

    name = config.method
    models = {d: kind.matchers[name] for d, kind in DETECTORS.items() if name in kind.matchers}
    model = None if features is None else models.get(features.detector)
    if features is None or model is None:
        wanted = " or ".join(f"features.detector={each}" for each in models)
        given = "features of your own" if features is None else f"'{features.detector}'"
        raise ConfigError(f"matching.method '{name}' needs {wanted}, not {given}")
    network = load(
        require_model(find_model(model)),
        features.backend,
        features.device,
        rewrite=None if name == "superglue" else lightglue.padded_model,
    )
    near = DescriptorMatcher(config.model_copy(update={"method": "mnn"}))
    if name == "superglue":
        matcher = superglue.SuperGlue(network)
        return lightglue.AssignmentMatcher(matcher, near, superglue.MIN_PROBABILITY)
    return lightglue.AssignmentMatcher(
        lightglue.LightGlue(network), near, lightglue.MIN_PROBABILITY
    )


def method_of(config: MatchingConfig, extractor: FeatureExtractor) -> MatchingName:
    """The configured method; for `auto` the one that suits an extractor's descriptors."""
    if config.method != "auto":
        return config.method
    return "mnn" if getattr(extractor, "suits_mutual_matching", False) else "brute_force"


def distances(query: Descriptors, train: Descriptors, q: Ints, t: Ints) -> Floats:
    """(n,) distances of pairs of rows: Hamming in bits for uint8, else Euclidean."""
    if query.dtype == np.uint8:
        a: NDArray[Any] = query[q]
        return np.asarray(np.bitwise_count(a ^ train[t]).sum(axis=1, dtype=np.float64))
    distance = np.empty(len(q))
    _euclidean(np.ascontiguousarray(query), np.ascontiguousarray(train), q, t, distance)
    return distance


@compiled
def _euclidean(query, train, q, t, distance):  # type: ignore[no-untyped-def]
    """Distances of pairs of rows; four sums, so that additions need not wait for each other."""
    width = query.shape[1]
    whole = width // 4 * 4
    for n in range(len(q)):
        a, b = query[q[n]], train[t[n]]
        s0 = s1 = s2 = s3 = 0.0
        for c in range(0, whole, 4):
            d0, d1 = np.float64(a[c] - b[c]), np.float64(a[c + 1] - b[c + 1])
            d2, d3 = np.float64(a[c + 2] - b[c + 2]), np.float64(a[c + 3] - b[c + 3])
            s0, s1, s2, s3 = s0 + d0 * d0, s1 + d1 * d1, s2 + d2 * d2, s3 + d3 * d3
        for c in range(whole, width):
            d0 = np.float64(a[c] - b[c])
            s0 += d0 * d0
        distance[n] = math.sqrt((s0 + s1) + (s2 + s3))


def _check_alike(query: Descriptors, train: Descriptors) -> None:
    is_same = query.shape[1:] == train.shape[1:] and query.dtype == train.dtype
    if is_same and query.ndim == 2 and query.dtype in (np.uint8, np.float32):
        return
    layouts = [f"{' x '.join(map(str, d.shape))} of {d.dtype}" for d in (query, train)]
    raise ValueError(
        f"descriptors are {layouts[0]} and {layouts[1]}, expected two of N x width of uint8 or "
        "float32"
    )


def _max_distance(descriptor: Descriptors) -> float:
    """Largest distance of a match; of float descriptors the ratio test decides alone."""
    return _MAX_BINARY * 8 * descriptor.shape[1] if descriptor.dtype == np.uint8 else np.inf


def _one_to_one(rows: Ints, nearest: Nearest) -> Ints:
    """Of queries (n,) that chose the same train feature, the nearest, or the first of equals."""
    order = rows[np.lexsort((rows, nearest.distance[rows]))]
    _, first = np.unique(nearest.row[order], return_index=True)
    return np.sort(order[first])


def _candidates(query: FeatureSet, train: FeatureSet, region: SearchRegion) -> _Candidates:
    assert train.xy is not None
    train_xy = np.ascontiguousarray(train.xy, dtype=np.float64)
    grid = make_grid(train_xy)
    if isinstance(region, Circles):
        assert query.xy is not None
        start = end = np.ascontiguousarray(query.xy, dtype=np.float64)
        radius_px = np.ascontiguousarray(region.radius_px, dtype=np.float64)
        tolerance_px = np.full(len(train), np.inf)
    else:
        assert isinstance(region, EpipolarSegments)
        start = np.ascontiguousarray(region.start, dtype=np.float64)
        end = np.ascontiguousarray(region.end, dtype=np.float64)
        tolerance_px = np.ascontiguousarray(region.tolerance_px, dtype=np.float64)
        radius_px = np.full(len(query), float(tolerance_px.max()) + _MARGIN_PX)
    rows = _inside(
        (start, end, radius_px, query.octave), (train_xy, tolerance_px, train.octave), grid
    )
    return _Candidates(*rows)


@compiled
def _inside(query, train, grid):  # type: ignore[no-untyped-def]
    """Pairs whose train feature lies within a distance of the query's segment, cell by cell."""
    start, end, radius_px, query_octave = query
    train_xy, tolerance_px, train_octave = train
    cell = 32.0
    capacity = max(16 * len(start), 1024)
    rows = np.empty((2, capacity), dtype=np.int64)
    count = 0
    for i in range(len(start)):
        dx, dy = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1]
        length = np.sqrt(dx * dx + dy * dy)
        dx, dy = (dx / length, dy / length) if length > 1e-9 else (1.0, 0.0)
        reach = radius_px[i]
        left = min(start[i, 0], end[i, 0]) - reach - grid.left
        right = max(start[i, 0], end[i, 0]) + reach - grid.left
        top = min(start[i, 1], end[i, 1]) - reach - grid.top
        bottom = max(start[i, 1], end[i, 1]) + reach - grid.top
        if not (left <= right and top <= bottom):  # a position that is not a number
            continue
        first_column = int(min(max(left / cell, 0.0), grid.columns))
        last_column = int(max(min(right / cell, grid.columns - 1.0), -1.0))
        first_row = int(min(max(top / cell, 0.0), grid.rows))
        last_row = int(max(min(bottom / cell, grid.rows - 1.0), -1.0))
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                at = row * grid.columns + column
                for k in range(grid.starts[at], grid.starts[at + 1]):
                    j = grid.order[k]
                    if abs(train_octave[j] - query_octave[i]) > 1:
                        continue
                    px, py = train_xy[j, 0] - start[i, 0], train_xy[j, 1] - start[i, 1]
                    along = min(max(px * dx + py * dy, 0.0), length)
                    ax, ay = px - along * dx, py - along * dy
                    limit = min(tolerance_px[j], reach)
                    if ax * ax + ay * ay > limit * limit:
                        continue
                    if count == capacity:
                        capacity *= 2
                        larger = np.empty((2, capacity), dtype=np.int64)
                        larger[:, :count] = rows[:, :count]
                        rows = larger
                    rows[0, count] = i
                    rows[1, count] = j
                    count += 1
    return rows[0, :count].copy(), rows[1, :count].copy()


@compiled
def _two_nearest(query, train, distance, count):  # type: ignore[no-untyped-def]
    """Row of the nearest candidate of each of `count` queries, and the two lowest distances."""
    row = np.full(count, -1, dtype=np.int64)
    first = np.full(count, np.inf)
    second = np.full(count, np.inf)
    for n in range(len(query)):
        i, d = query[n], distance[n]
        if d < first[i] or (d == first[i] and train[n] < row[i]):
            second[i] = first[i]
            first[i] = d
            row[i] = train[n]
        elif d < second[i]:
            second[i] = d
    return row, first, second


def grid_motion_consistent(
    matches: Matches,
    query: Floats32,
    train: Floats32,
    sizes: tuple[tuple[int, int], tuple[int, int]],
) -> Matches:
    """Matches that their neighbours support (GMS), of two images of (width, height).

    Source: Bian et al., "GMS: grid-based motion statistics for fast, ultra-robust feature
    correspondence", CVPR 2017.

    Args:
        matches: many of them, at best without a ratio test.
        query: (N, 2) pixels.
        train: (M, 2) pixels.
        sizes: of both images.

    Raises:
        ConfigError: this build of OpenCV does not have it.
    """
    match = require_function("matchGMS", "matching with GMS")
    points = [[cv2.KeyPoint(u, v, 1.0) for u, v in each.tolist()] for each in (query, train)]
    pairs = zip(matches.query.tolist(), matches.train.tolist(), matches.score.tolist(), strict=True)
    given = [cv2.DMatch(q, t, s) for q, t, s in pairs]
    kept = match(*sizes, *points, given, withRotation=False, withScale=False)
    rows = {m.queryIdx for m in kept}
    good = np.array([q in rows for q in matches.query.tolist()], dtype=bool)
    return Matches(matches.query[good], matches.train[good], matches.score[good])
