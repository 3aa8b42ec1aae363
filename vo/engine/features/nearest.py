"""Search for the two nearest descriptors: exact, by FLANN, or by OpenCV's ANN index."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np

from vo.base.types import Descriptors, Floats, Ints

_FLANN_KD_TREE, _FLANN_LSH = 1, 6
_KD_TREES, _LSH = 4, {"table_number": 12, "key_size": 20, "multi_probe_level": 2}
_CHECKS = 64
_ANN_TREES, _ANN_SEARCH = 16, 400
_MAX_ANN_BYTES = 32  # OpenCV 5.0 counts the differing bits in 8 bits
_SEED = 1
_FEW = 32  # train descriptors below which an index brings nothing, and FLANN may crash


class Nearest(NamedTuple):
    """The nearest train descriptor of each query.

    Attributes:
        row: (N,) row of it, -1 for none.
        distance: (N,) to it, inf for none.
        second: (N,) to the second nearest, inf for none.
    """

    row: Ints
    distance: Floats
    second: Floats


Search = Callable[[Descriptors, Descriptors], Nearest]
"""Finds for each query descriptor (N, width) the nearest of train descriptors (M, width)."""


def make_search(method: str) -> Search:
    """The search of a setting `matching.method`."""
    return {"flann": _flann, "ann": _ann}.get(method, brute_force)


def brute_force(query: Descriptors, train: Descriptors) -> Nearest:
    """Exact: all pairs are compared."""
    norm = cv2.NORM_HAMMING if query.dtype == np.uint8 else cv2.NORM_L2
    return _of_pairs(cv2.BFMatcher(norm).knnMatch(query, train, k=2), len(query))


def _flann(query: Descriptors, train: Descriptors) -> Nearest:
    """Approximate: k-d trees for float descriptors, locality-sensitive hashing for binary ones.

    Source: Muja and Lowe, "Scalable nearest neighbor algorithms for high dimensional data", 2014.
    """
    if len(train) < _FEW:
        return brute_force(query, train)
    cv2.setRNGSeed(_SEED)  # its trees and hashes are random
    index: dict[str, Any] = {"algorithm": _FLANN_KD_TREE, "trees": _KD_TREES}
    if query.dtype == np.uint8:
        index = {"algorithm": _FLANN_LSH, **_LSH}
    matcher = cv2.FlannBasedMatcher(index, {"checks": _CHECKS})
    return _of_pairs(matcher.knnMatch(query, train, k=2), len(query))


def _ann(query: Descriptors, train: Descriptors) -> Nearest:
    """Approximate: a forest of random projections (OpenCV 5's ANNIndex, after Annoy).

    Exact for binary descriptors of more than 256 bits, whose distances overflow there.
    """
    is_binary = query.dtype == np.uint8
    if len(train) < _FEW or (is_binary and query.shape[1] > _MAX_ANN_BYTES):
        return brute_force(query, train)
    kind = cv2.ANNIndex_DIST_HAMMING if is_binary else cv2.ANNIndex_DIST_EUCLIDEAN
    index = cv2.ANNIndex.create(query.shape[1], kind)
    index.setSeed(_SEED)
    index.addItems(np.ascontiguousarray(train))
    index.build(_ANN_TREES)
    rows, found = index.knnSearch(np.ascontiguousarray(query), 2, search_k=_ANN_SEARCH)
    distance = found.astype(np.float64)
    distance[rows < 0] = np.inf
    return Nearest(rows[:, 0].astype(np.int64), distance[:, 0], distance[:, 1])


def _of_pairs(pairs: Any, count: int) -> Nearest:
    row = np.full(count, -1, dtype=np.int64)
    distance = np.full((count, 2), np.inf)
    for n, pair in enumerate(pairs):
        for k, match in enumerate(pair):
            distance[n, k] = match.distance
            if k == 0:
                row[n] = match.trainIdx
    return Nearest(row, distance[:, 0], distance[:, 1])
