"""Index of all stored features: which parts a scene may show, without comparing with each.

Codes of 256 bits are sorted by some of their bits, in several tables; a feature of a scene is
compared with those that have the same bits as it in a table.

Source: Indyk and Motwani, "Approximate nearest neighbors", STOC 1998 (locality-sensitive hashing).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.compiling.function import compiled
from vo.frontend.hamming_kernels import hamming
from vo.objects.records import Codes
from vo.objects.scene_features import CODE_BITS
from vo.types import Floats, Floats32, Ints

MAX_CANDIDATES = 12
_TABLES = 16
_MIN_KEY_BITS, _MAX_KEY_BITS = 8, 16
_IN_BUCKET = 32  # wanted features of a table with the same key
_MAX_BITS = 84  # in which codes of the same place may differ
_NEAREST = 5  # parts that a feature votes for
_TURNS, _ZOOMS = 12, 8  # bins of the motion that a feature and a stored one imply
_ZOOM_STEP = np.log(2.0)
_MIN_SCORE = 10.0  # bits
_SEED = 340

_Keys = NDArray[np.uint16]


class IndexedFeatures(NamedTuple):
    """Features as the index compares them; rows belong together.

    Attributes:
        code: (N, 4) words of 64 bits.
        angle: (N,) radians, 0 without orientation.
        size: (N,) relative to the smallest features.
    """

    code: Codes
    angle: Floats32
    size: Floats32


class CandidateIndex:
    """Features of many parts.

    Args:
        parts: features of each.
    """

    def __init__(self, parts: Sequence[IndexedFeatures]) -> None:
        self._parts = len(parts)
        self._code = np.concatenate([*(each.code for each in parts), np.zeros((0, 4), np.uint64)])
        self._motion = _motion(parts)
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

    def candidates(self, scene: IndexedFeatures) -> list[int]:
        """Numbers of the parts that a scene may show, the likeliest first."""
        if not len(scene.code) or not len(self._code):
            return []
        keys = np.ascontiguousarray(_keys(scene.code, self._bits).T)
        stored = self._order, self._begin, self._code, self._part, self._motion
        score: Floats = _votes(scene.code, keys, _motion([scene]), stored, self._parts)
        order: Ints = np.argsort(-score, kind="stable")[:MAX_CANDIDATES]
        return [n for n in order.tolist() if score[n] >= _MIN_SCORE]


def _motion(parts: Sequence[IndexedFeatures]) -> Floats32:
    """(N, 2) angle in bins of turns, and logarithm of the size in bins of zooms."""
    rows = [
        np.column_stack(
            [
                np.nan_to_num(each.angle) * (_TURNS / (2.0 * np.pi)),
                np.log(each.size) / _ZOOM_STEP,
            ]
        )
        for each in parts
    ]
    return np.concatenate([*rows, np.zeros((0, 2))]).astype(np.float32)


def _keys(code: Codes, bits: Ints) -> _Keys:
    """(tables, N) of codes (N, 4): chosen bits (tables, key bits) as a number."""
    result = np.zeros((len(bits), len(code)), np.uint16)
    for table, chosen in enumerate(bits.tolist()):
        for place, bit in enumerate(chosen):
            one = (code[:, bit >> 6] >> np.uint64(bit & 63)) & np.uint64(1)
            result[table] |= (one << np.uint64(place)).astype(np.uint16)
    return result


@compiled
def _votes(code, keys, motion, stored, parts):  # type: ignore[no-untyped-def]
    """Score of each part: by how much it is nearer than parts in general, of the commonest motion.

    Source: McCann and Lowe, "Local naive Bayes nearest neighbor for image classification", CVPR
    2012, algorithm 2; Jegou et al., "Hamming embedding and weak geometric consistency", ECCV 2008.
    """
    order, begin, codes, part, motions = stored
    votes = np.zeros((parts, _TURNS, _ZOOMS), dtype=np.float32)
    seen = np.full(parts, -1, dtype=np.int64)
    best = np.empty(parts, dtype=np.int64)
    nearest = np.empty(parts, dtype=np.int64)
    hit = np.empty(parts, dtype=np.int64)
    for n in range(len(code)):
        hits = 0
        for table in range(len(order)):
            key = keys[n, table]
            for at in range(begin[table, key], begin[table, key + 1]):
                row = order[table, at]
                distance = np.int64(hamming(code[n], codes[row]))
                if distance > _MAX_BITS:
                    continue
                p = part[row]
                if seen[p] != n:
                    seen[p] = n
                    hit[hits] = p
                    hits += 1
                    best[p] = distance
                    nearest[p] = row
                elif distance < best[p]:
                    best[p] = distance
                    nearest[p] = row
        # The nearest parts come first; the next one is the level of parts in general.
        for k in range(min(hits, _NEAREST + 1)):
            least = k
            for h in range(k + 1, hits):
                if best[hit[h]] < best[hit[least]]:
                    least = h
            hit[k], hit[least] = hit[least], hit[k]
        level = best[hit[_NEAREST]] if hits > _NEAREST else np.int64(_MAX_BITS)
        for k in range(min(hits, _NEAREST)):
            p = hit[k]
            weight = np.float32(level - best[p])
            turn = (motion[n, 0] - motions[nearest[p], 0]) % _TURNS
            zoom = motion[n, 1] - motions[nearest[p], 1] + _ZOOMS // 2
            zoom = min(max(zoom, 0.0), _ZOOMS - 1.001)
            t, z = int(turn), int(zoom)
            for dt in range(2):
                for dz in range(2):
                    votes[p, (t + dt) % _TURNS, z + dz] += weight
    score = np.zeros(parts, dtype=np.float64)
    for p in range(parts):
        for t in range(_TURNS):
            for z in range(_ZOOMS):
                score[p] = max(score[p], votes[p, t, z])
    return score
