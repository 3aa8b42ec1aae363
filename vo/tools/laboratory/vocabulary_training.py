"""Vocabularies trained on recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from vo.base.config import FeaturesConfig
from vo.base.types import Bytes
from vo.engine.features.extractor import make_extractor
from vo.engine.places.vocabulary import Vocabulary, packed, train
from vo.recordings.sources.registry import open_source


def train_on(
    sources: Sequence[Path],
    every: int = 10,
    features: FeaturesConfig | None = None,
    seed: int = 0,
    on_recording: Callable[[str, int], None] | None = None,
) -> Vocabulary:
    """Train a vocabulary on the images of camera 0 of recordings.

    Args:
        sources: recordings.
        every: use every n-th frame; neighbouring frames are nearly the same.
        features: detector and descriptor; binary descriptors of 32 bytes.
        seed: of the training.
        on_recording: called with the name of each recording and its number of images.

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
