"""Memory, disk space and query times of the database of keyframes, with a synthetic stream.

Each keyframe has 1500 features, most of which the 3 before it have too, and 300 landmarks. Words
are as frequent as in the images that the vocabulary was trained on.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Iterator

import numpy as np

from vo.base.types import Bytes
from vo.engine.mapping.keyframe import FrameId
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import PATCH_PX, Place, PlaceKey, PlaceLandmarks
from vo.engine.places.vocabulary_file import built_in_vocabulary

FEATURES, NEW_FEATURES, LANDMARKS, NEW_LANDMARKS = 1500, 400, 300, 80
FLIPPED_BITS = 8


def stream(count: int, words: Bytes, images_with: np.ndarray, seed: int) -> Iterator[Place]:
    """Keyframes along a path."""
    random = np.random.default_rng(seed)
    chance = np.cumsum(images_with) / images_with.sum()
    patch = random.integers(0, 256, (LANDMARKS, PATCH_PX, PATCH_PX), dtype=np.uint8)
    thumbnail = random.integers(0, 256, (120, 188), dtype=np.uint8)
    floats = random.normal(size=(LANDMARKS, 3)).astype(np.float32)
    descriptor = np.zeros((0, 32), np.uint8)
    for n in range(count):
        new = FEATURES if n == 0 else NEW_FEATURES
        fresh = words[np.searchsorted(chance, random.random(new))].copy()
        for _ in range(FLIPPED_BITS):
            at = random.integers(0, 256, new)
            fresh[np.arange(new), at >> 3] ^= (1 << (at & 7)).astype(np.uint8)
        descriptor = np.concatenate([descriptor, fresh])[-FEATURES:]
        landmarks = PlaceLandmarks(
            id=np.arange(n * NEW_LANDMARKS, n * NEW_LANDMARKS + LANDMARKS),
            xyz=floats,
            xy=floats[:, :2],
            sigma=floats[:, 0],
            descriptor=descriptor[:LANDMARKS],
            octave=np.zeros(LANDMARKS, np.int32),
            angle=floats[:, 1],
            patch=patch,
        )
        frame = FrameId(5 * n, 250_000_000 * n, 0)
        pose, covariance = np.eye(4), np.eye(6) * 1e-4
        yield Place(PlaceKey(0, n), frame, True, pose, covariance, descriptor, landmarks, thumbnail)


def main() -> None:
    """Print a line at each power of ten."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    arguments = parser.parse_args()
    vocabulary = built_in_vocabulary()
    leaves = vocabulary.descriptor[vocabulary.children[1:] == 0]
    marks = {10**n for n in range(2, 9)} | {arguments.count}
    print("keyframes   add, ms   query, ms (median, max of 50)   peak memory, MB   file, MB")
    begin, before = time.process_time(), 0
    with KeyframeDatabase(vocabulary) as database:
        for place in stream(arguments.count, leaves, vocabulary.images_with, 1):
            database.add(place)
            count = place.key.keyframe + 1
            if count not in marks:
                continue
            add_ms = 1e3 * (time.process_time() - begin) / (count - before)
            times = []
            for n in np.linspace(0, count - 1, 50).astype(int).tolist():
                if PlaceKey(0, n) in database:
                    query = database.get(PlaceKey(0, n))
                    if not times:
                        database.query(query)  # may compile
                    start = time.process_time()
                    database.query(query)
                    times.append(1e3 * (time.process_time() - start))
            peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{count:9d}   {add_ms:7.2f}   {np.median(times):10.1f} {max(times):8.1f}"
                f"   {peak_mb:24.0f}   {database.file_bytes / 1e6:9.0f}",
                flush=True,
            )
            begin, before = time.process_time(), count


if __name__ == "__main__":
    main()
