"""Index of all stored features: which parts a scene may show, without comparing with each.

Codes of 256 bits are sorted by some of their bits, in several tables; a feature of a scene is
compared with those that have the same bits as it in a table.

Source: Indyk and Motwani, "Approximate nearest neighbors", STOC 1998 (locality-sensitive hashing).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.types import Floats, Floats32, Ints
from vo.engine.frontend.hamming_kernels import hamming
from vo.tools.objects.agreement import largest_agreements, moves
from vo.tools.objects.scene_features import CODE_BITS
from vo.tools.objects.stored_objects import Codes

MAX_CANDIDATES = 20
_TABLES = 16
_MIN_KEY_BITS, _MAX_KEY_BITS = 8, 16
_IN_BUCKET = 8  # wanted features of a table with the same key
_MAX_BITS = 84  # in which codes of the same place may differ
_NEAREST = 5  # parts that a feature votes for
_TRIED = 60  # matches of a part that are tried as its motion
_MIN_SCORE = 10.0  # bits
_SEED = 340
_PIECES = 8  # of the work for several threads; results do not depend on their number

_Keys = NDArray[np.uint16]


class IndexedFeatures(NamedTuple):
    """Features as the index compares them; rows belong together."""

    code: Codes  # (N, 4) words of 64 bits
    xy: Floats32  # (N, 2) pixels
    angle: Floats32  # (N,) radians, NaN without orientation
    size: Floats32  # (N,) relative to the smallest features


class CandidateIndex:
    """Features of many parts."""

    def __init__(self, parts: Sequence[IndexedFeatures]) -> None:
        self._parts = len(parts)
        self._code = np.concatenate([*(each.code for each in parts), np.zeros((0, 4), np.uint64)])
        self._xy = np.concatenate([*(each.xy for each in parts), np.zeros((0, 2), np.float32)])
        nothing = np.zeros(0, np.float32)
        self._angle = np.concatenate([*(each.angle for each in parts), nothing])
        self._size = np.concatenate([*(each.size for each in parts), nothing])
        counts = [len(each.code) for each in parts]
        self._part = np.repeat(np.arange(len(parts), dtype=np.int32), counts)
        wanted = np.log2(max(len(self._code), 1) / _IN_BUCKET)
        key_bits = int(np.clip(np.rint(wanted), _MIN_KEY_BITS, _MAX_KEY_BITS))
        random = np.random.default_rng(_SEED)
        chosen = [random.choice(CODE_BITS, key_bits, replace=False) for _ in range(_TABLES)]
        self._bits = np.stack(chosen)
        keys = _keys(self._code, self._bits)
        order = [np.argsort(each, kind="stable").astype(np.int32) for each in keys]
        self._order = np.stack(order)
        counted = [np.bincount(each, minlength=2**key_bits) for each in keys]
        self._begin = np.stack([np.concatenate([[0], np.cumsum(each)]) for each in counted])

    def candidates(self, scene: IndexedFeatures, pool: Executor) -> list[int]:
        """Numbers of the parts that a scene may show, the likeliest first."""
        if not len(scene.code) or not len(self._code):
            return []
        part, row, weight = self._votes(scene.code, pool)
        feature, place = np.nonzero(part >= 0)
        part = part[feature, place]
        order = np.argsort(part, kind="stable")
        feature, place = feature[order], place[order]
        begin = np.searchsorted(part[order], np.arange(self._parts + 1))
        rows, weights = row[feature, place], weight[feature, place]
        score: Floats
        if np.isnan(scene.angle).any():
            score = np.bincount(part[order], weights, self._parts).astype(np.float64)
        else:
            motion = moves(
                (self._xy[rows], self._angle[rows], self._size[rows]),
                (scene.xy[feature], scene.angle[feature], scene.size[feature]),
            )
            score = _scores(motion, weights, begin, pool)
        best: Ints = np.argsort(-score, kind="stable")[:MAX_CANDIDATES]
        return [n for n in best.tolist() if score[n] >= _MIN_SCORE]

    def _votes(self, code: Codes, pool: Executor) -> tuple[Ints, Ints, Floats32]:
        """What `_nearest_parts` gives, of all features of a scene."""
        keys = np.ascontiguousarray(_keys(code, self._bits).T)
        stored = self._order, self._begin, self._code, self._part

        def votes(piece: slice) -> tuple[Ints, Ints, Floats32]:
            found: tuple[Ints, Ints, Floats32] = _nearest_parts(code[piece], keys[piece], stored)
            return found

        part, row, weight = zip(*pool.map(votes, _pieces(len(code))), strict=True)
        return np.concatenate(part), np.concatenate(row), np.concatenate(weight)


def _scores(motion: Floats, weights: Floats32, begin: Ints, pool: Executor) -> Floats:
    """What `largest_agreements` gives, of all parts."""

    def scores(piece: slice) -> Floats:
        edges = begin[piece.start : piece.stop + 1]
        found: Floats = largest_agreements(motion, weights, edges, _TRIED)
        return found

    return np.concatenate(list(pool.map(scores, _pieces(len(begin) - 1))))


def _pieces(count: int) -> list[slice]:
    edges = np.linspace(0, count, _PIECES + 1).astype(int).tolist()
    return [slice(low, high) for low, high in pairwise(edges)]


def _keys(code: Codes, bits: Ints) -> _Keys:
    """(tables, N) of codes (N, 4): chosen bits (tables, key bits) as a number."""
    result = np.zeros((len(bits), len(code)), np.uint16)
    for table, chosen in enumerate(bits.tolist()):
        for place, bit in enumerate(chosen):
            one = (code[:, bit >> 6] >> np.uint64(bit & 63)) & np.uint64(1)
            result[table] |= (one << np.uint64(place)).astype(np.uint16)
    return result


@compiled
def _nearest_parts(code, keys, stored):  # type: ignore[no-untyped-def]
    """(N, nearest) parts, rows and weights of each feature of a scene; part -1 for none.

    Source: McCann and Lowe, "Local naive Bayes nearest neighbor for image classification", CVPR
    2012, algorithm 2.
    """
    part = np.full((len(code), _NEAREST + 1), -1, dtype=np.int64)
    row = np.zeros((len(code), _NEAREST + 1), dtype=np.int64)
    distance = np.full((len(code), _NEAREST + 1), _MAX_BITS + 1, dtype=np.int64)
    weight = np.zeros((len(code), _NEAREST), dtype=np.float32)
    for n in range(len(code)):
        _find_nearest(code[n], keys[n], stored, (part[n], row[n], distance[n]))
        # The nearest parts count; the next one is the level of parts in general.
        level = min(distance[n, _NEAREST], _MAX_BITS)
        for k in range(_NEAREST):
            if part[n, k] >= 0:
                weight[n, k] = np.float32(level - distance[n, k])
    return part[:, :_NEAREST], row[:, :_NEAREST], weight


@compiled(**NO_REFCOUNT)
def _find_nearest(code, keys, stored, nearest):  # type: ignore[no-untyped-def]
    """Fill in the nearest parts of a feature, their nearest rows and distances, nearest first."""
    order, begin, codes, part = stored
    parts, rows, distances = nearest
    last = len(parts) - 1
    for table in range(len(order)):
        key = keys[table]
        for at in range(begin[table, key], begin[table, key + 1]):
            row = order[table, at]
            distance = np.int64(hamming(code, codes[row]))
            if distance >= distances[last]:
                continue
            p = part[row]
            k = 0
            while k < last and parts[k] != p:
                k += 1
            if parts[k] == p and distances[k] <= distance:
                continue
            while k > 0 and distances[k - 1] > distance:
                parts[k], rows[k], distances[k] = parts[k - 1], rows[k - 1], distances[k - 1]
                k -= 1
            parts[k], rows[k], distances[k] = p, row, distance
