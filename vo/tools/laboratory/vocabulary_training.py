"""Vocabularies trained on recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.config import FeaturesConfig
from vo.base.errors import InputError
from vo.base.types import Bytes, Ints
from vo.engine.features.extractor import make_extractor
from vo.engine.frontend.hamming_kernels import hamming
from vo.engine.places.vocabulary import Packed, Vocabulary, packed
from vo.recordings.sources.registry import open_source

BRANCHES = 10  # k of DBoW2
DEPTH = 4  # L of DBoW2
_MAX_ROUNDS = 12  # of k-majority; later ones move a few per mille of the descriptors


def train_on(
    sources: Sequence[Path],
    every: int = 10,
    features: FeaturesConfig | None = None,
    seed: int = 0,
    on_recording: Callable[[str, int], None] | None = None,
) -> Vocabulary:
    """Train a vocabulary on the images of camera 0 of recordings.

    `every`: use every n-th frame; neighbouring frames are nearly the same. `features`: detector and
    descriptor; binary descriptors of 32 bytes. `on_recording`: called with the name of each
    recording and its number of images.

    Raises:
        SourceError: a recording cannot be read.
        InputError: the descriptors are not binary, or there are too few.
    """
    extractor = make_extractor(features or FeaturesConfig())

    def descriptors(path: Path) -> Iterator[Bytes]:
        recording = open_source(path, mode="mono")
        for frame in recording.frames(0, None, every):
            descriptor = extractor.extract(frame.image0, frame.mask).descriptor
            packed(descriptor)  # refuses others at the first image
            yield descriptor.view("u1")

    images: list[Bytes] = []
    for path in sources:
        before = len(images)
        images.extend(descriptors(path))
        if on_recording is not None:
            on_recording(str(path), len(images) - before)
    return train(images, seed)


def train(
    images: Sequence[Bytes], seed: int = 0, branches: int = BRANCHES, depth: int = DEPTH
) -> Vocabulary:
    """Make a vocabulary of the (N, 32) uint8 descriptors of many images.

    Raises:
        InputError: there are fewer descriptors than children of a node.
    """
    everything = packed(np.concatenate(images)) if images else np.zeros((0, 4), np.uint64)
    if len(everything) < branches:
        raise InputError(
            f"{len(everything)} features in {len(images)} images; a vocabulary needs at least "
            f"{branches}, and good ones need hundreds of thousands"
        )
    random = np.random.default_rng(seed)
    level = [np.arange(len(everything))]
    centres: list[Packed] = []
    children: list[int] = []
    for remaining in range(depth, -1, -1):
        below: list[Ints] = []
        for rows in level:
            parts = _split(everything, rows, branches, random) if remaining else []
            children.append(len(parts))
            for centre, members in parts:
                centres.append(centre)
                below.append(members)
        level = below
    descriptor = np.array(centres, np.uint64).view(np.uint8)
    counts = np.array(children, np.int64)
    tree = Vocabulary(descriptor, counts, len(images), np.zeros(0, np.int64))
    images_with = np.zeros(int((counts == 0).sum()), np.int64)
    for image in images:
        if len(image):
            images_with[np.unique(tree.words_of(image))] += 1
    return Vocabulary(descriptor, counts, len(images), images_with)


def _split(
    everything: Packed, rows: Ints, branches: int, random: np.random.Generator
) -> list[tuple[Packed, Ints]]:
    """Clusters of some descriptors: their centres and rows; none if all are the same.

    Source: Grana et al., "A fast approach for integrating ORB descriptors in the bag of words
    model", SPIE 2013 (k-majority); Arthur and Vassilvitskii, "k-means++", SODA 2007.
    """
    members = everything[rows]
    centres = _first_centres(members, branches, random)
    if len(centres) < 2:
        return []
    nearest = _nearest(members, centres)
    for _ in range(_MAX_ROUNDS):
        centres = _majorities(members, nearest, centres)
        before, nearest = nearest, _nearest(members, centres)
        if np.array_equal(before, nearest):
            break
    clusters = [(c, rows[nearest == n]) for n, c in enumerate(centres)]
    return [(centre, inside) for centre, inside in clusters if len(inside)]


def _first_centres(members: Packed, branches: int, random: np.random.Generator) -> Packed:
    """Centres far from each other, by k-means++; fewer if there are fewer different ones."""
    chosen = [int(random.integers(len(members)))]
    distance = _distances(members, members[chosen[0]])
    while len(chosen) < branches:
        cumulative = np.cumsum(distance * distance)
        if cumulative[-1] == 0:
            break
        at = np.searchsorted(cumulative, random.random() * cumulative[-1], side="right")
        chosen.append(int(min(at, len(members) - 1)))
        distance = np.minimum(distance, _distances(members, members[chosen[-1]]))
    return members[chosen]


@compiled
def _nearest(members, centres):  # type: ignore[no-untyped-def]
    """The nearest centre of each descriptor; the first of equally near ones."""
    result = np.empty(len(members), dtype=np.int64)
    for i in range(len(members)):
        best, least = 0, hamming(members[i], centres[0])
        for c in range(1, len(centres)):
            distance = hamming(members[i], centres[c])
            if distance < least:
                best, least = c, distance
        result[i] = best
    return result


@compiled
def _distances(members, centre):  # type: ignore[no-untyped-def]
    """Hamming distance of each descriptor from one."""
    result = np.empty(len(members), dtype=np.float64)
    for i in range(len(members)):
        result[i] = hamming(members[i], centre)
    return result


@compiled
def _majorities(members, nearest, centres):  # type: ignore[no-untyped-def]
    """Of each cluster the bits that most of its members have; an empty one keeps its centre."""
    votes = np.zeros((len(centres), 256), dtype=np.int64)
    size = np.zeros(len(centres), dtype=np.int64)
    one = np.uint64(1)
    for i in range(len(members)):
        size[nearest[i]] += 1
        for bit in range(256):
            word = members[i, bit >> 6] >> np.uint64(bit & 63)
            votes[nearest[i], bit] += np.int64(word & one)
    result = centres.copy()
    for c in range(len(centres)):
        if size[c] == 0:
            continue
        for w in range(4):
            value = np.uint64(0)
            for bit in range(64):
                if 2 * votes[c, 64 * w + bit] > size[c]:
                    value |= one << np.uint64(bit)
            result[c, w] = value
    return result
