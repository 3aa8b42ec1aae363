"""Small vocabularies and stored keyframes for tests."""

from __future__ import annotations

import numpy as np

from vo.base.types import Bytes, Ints
from vo.engine.mapping.keyframe import FrameId
from vo.engine.places.records import PATCH_PX, Place, PlaceKey, PlaceLandmarks
from vo.engine.places.vocabulary import Vocabulary
from vo.tools.laboratory.vocabulary_training import train

WIDTH = 32


def random_descriptors(random: np.random.Generator, count: int) -> Bytes:
    return random.integers(0, 256, (count, WIDTH), dtype=np.uint8)


def small_vocabulary(seed: int = 0, depth: int = 3) -> Vocabulary:
    """Vocabulary of random descriptors, 5 branches."""
    random = np.random.default_rng(seed)
    return train([random_descriptors(random, 200) for _ in range(20)], seed, 5, depth)


def make_place(
    number: int,
    descriptor: Bytes,
    ids: Ints | None = None,
    session: int = 0,
    segment: int = 0,
    seed: int = 0,
) -> Place:
    """A stored keyframe with random contents, but for what is given."""
    random = np.random.default_rng([seed, session, number])
    ids = np.arange(number * 10, number * 10 + 30) if ids is None else np.asarray(ids, np.int64)
    count = len(ids)
    landmarks = PlaceLandmarks(
        id=ids,
        xyz=random.normal(size=(count, 3)).astype(np.float32),
        xy=random.uniform(0, 100, (count, 2)).astype(np.float32),
        sigma=np.full(count, 0.1, np.float32),
        descriptor=random_descriptors(random, count),
        octave=random.integers(0, 4, count).astype(np.int32),
        angle=random.uniform(-3, 3, count).astype(np.float32),
        patch=random.integers(0, 256, (count, PATCH_PX, PATCH_PX), dtype=np.uint8),
    )
    pose = np.eye(4)
    pose[2, 3] = number
    frame = FrameId(5 * number, 50_000_000 * number, segment)
    thumbnail = random.integers(0, 256, (12, 16), dtype=np.uint8)
    covariance = np.eye(6) * 1e-4
    return Place(
        *(PlaceKey(session, number), frame, True, pose, covariance, descriptor, landmarks),
        thumbnail,
        is_doubted=number % 3 == 2,
    )
