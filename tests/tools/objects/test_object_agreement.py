"""Matches that move alike are told from others, and rank the parts of an index."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from vo.base.types import Floats, Floats32
from vo.tools.objects.agreement import best_agreement, largest_agreements, moves
from vo.tools.objects.candidates import CandidateIndex, IndexedFeatures

TURN, ZOOM, SHIFT = 0.8, 0.4, np.array([500.0, 300.0])
Features = tuple[Floats32, Floats32, Floats32]


def features(rng: np.random.Generator, count: int, size: float = 400.0) -> Features:
    """Places, angles and sizes."""
    return (
        rng.uniform(0.0, size, (count, 2)).astype(np.float32),
        rng.uniform(-np.pi, np.pi, count).astype(np.float32),
        np.exp2(rng.uniform(0.0, 3.0, count)).astype(np.float32),
    )


def moved(stored: Features) -> Features:
    """Features after one turn, zoom and shift."""
    turn = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])
    xy = ZOOM * stored[0] @ turn.T + SHIFT
    return xy.astype(np.float32), stored[1] + np.float32(TURN), stored[2] * np.float32(ZOOM)


def joined(*parts: Features) -> Features:
    """Features of all."""
    xy, angle, size = (np.concatenate(each) for each in zip(*parts, strict=True))
    return xy, angle, size


def motions() -> Floats:
    """Those of 30 matches that move alike, and of 200 that do not."""
    rng = np.random.default_rng(1)
    right, wrong = features(rng, 30), features(rng, 200)
    return moves(joined(right, wrong), joined(moved(right), features(rng, 200, 1000.0)))


def test_matches_that_move_alike_are_found_among_others() -> None:
    agree = best_agreement(motions(), np.arange(230))
    assert agree[:30].all()
    assert np.count_nonzero(agree[30:]) <= 3


def test_matches_of_one_place_count_once() -> None:
    """A letter that the scene repeats is one place of the stored side."""
    rng = np.random.default_rng(2)
    right = features(rng, 8)
    letter = tuple(np.repeat(each[:1], 40, axis=0) for each in features(rng, 1))
    assert len(letter) == 3
    # All copies are at nearly the same place of the scene, so that they agree with each other.
    copies = letter[0] + rng.uniform(-2.0, 2.0, (40, 2)).astype(np.float32), *letter[1:]
    motion = moves(joined(letter, right), joined(copies, moved(right)))
    place = np.concatenate([np.zeros(40, np.int64), np.arange(1, 9)])
    assert best_agreement(motion, place)[40:].all()
    assert best_agreement(motion, np.arange(48))[:40].all()


def test_the_weights_of_the_largest_group_are_summed() -> None:
    motion = motions()
    weight = np.ones(230, np.float32)
    weight[:30] = 2.0
    begin = np.array([0, 30, 230, 230])
    right, wrong, nothing = largest_agreements(motion, weight, begin, 60)
    assert right == 60.0
    assert 1.0 <= wrong <= 8.0
    assert nothing == 0.0


def test_the_index_ranks_a_part_by_where_its_features_are() -> None:
    """Fifteen features of a part in their places outrank 60 of another one scattered about."""
    rng = np.random.default_rng(3)
    parts = []
    for _ in range(200):
        code = rng.integers(0, 2**63, (100, 4), dtype=np.uint64)
        parts.append(IndexedFeatures(code, *features(rng, 100)))
    shown, scattered = parts[17], parts[5]
    at_place = moved((shown.xy[:15], shown.angle[:15], shown.size[:15]))
    turned_alike = moved((scattered.xy[:60], scattered.angle[:60], scattered.size[:60]))
    anywhere = rng.uniform(0.0, 1000.0, (60, 2)).astype(np.float32), *turned_alike[1:]
    code = np.concatenate(
        [
            noisy(rng, shown.code[:15]),
            noisy(rng, scattered.code[:60]),
            rng.integers(0, 2**63, (2000, 4), dtype=np.uint64),
        ]
    )
    scene = joined(at_place, anywhere, features(rng, 2000, 1000.0))
    index = CandidateIndex(parts)
    with ThreadPoolExecutor(2) as pool:
        assert index.candidates(IndexedFeatures(code, *scene), pool)[0] == 17
    # Without orientation only the number of votes is left.
    unturned = IndexedFeatures(code, scene[0], np.full(len(code), np.nan, np.float32), scene[2])
    with ThreadPoolExecutor(2) as pool:
        assert index.candidates(unturned, pool)[:2] == [5, 17]


def noisy(rng: np.random.Generator, code: np.ndarray) -> np.ndarray:
    """Codes with about 30 of 256 bits changed."""
    flip = np.packbits(rng.random((len(code), 256)) < 30 / 256, axis=1).view(np.uint64)
    return np.asarray(code ^ flip)
