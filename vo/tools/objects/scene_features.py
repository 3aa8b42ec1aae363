"""Features of images for recognition: which are extracted, and vectors that compare all kinds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from vo.base.config import FeaturesConfig
from vo.base.settings import validate
from vo.base.types import Bytes, Descriptors, Floats32, Ints, Keypoints
from vo.engine.features.extractor import make_extractor
from vo.engine.frontend.contracts import FeatureExtractor
from vo.tools.objects.stored_objects import Codes

SCENE_COUNT = 8000  # of an image that is searched: an object may be a small part of it
STORED_COUNT, _STORED_OF_SIZE = 3000, 300  # of a stored image: found, and kept of each size
_LEVELS = 8  # of pyramids; an object may be seen at a third or three times of its stored size
CODE_BITS = 256
_NEIGHBOURHOOD_PX = 40.0  # standard deviation of the neighbourhood that light is even in
_STEP_PX = 8  # in which they are computed
_CONTRAST = 50.0  # grey levels, standard deviation
_MAX_GAIN = 4.0  # more would raise the noise of a camera
_SEED = 34


@dataclass(frozen=True, eq=False)
class SceneFeatures:
    """Features of an image in which objects are searched; rows belong together."""

    xy: Floats32  # (N, 2) pixels
    angle: Floats32  # (N,) radians, NaN without orientation
    size: Floats32  # (N,) relative to the smallest features; 1 without scale
    descriptor: Descriptors  # (N, width)
    vector: Floats32  # (N, width) unit vectors

    def __len__(self) -> int:
        return len(self.xy)

    def select(self, rows: Ints) -> SceneFeatures:
        """Some of them."""
        return SceneFeatures(
            self.xy[rows],
            self.angle[rows],
            self.size[rows],
            self.descriptor[rows],
            self.vector[rows],
        )


def stored_extractor(detector: str, descriptor: str) -> FeatureExtractor:
    """The extractor for stored images.

    Raises:
        ConfigError: there is none of this name, this installation lacks it, or the names do not go
            together.
        ModelError: its model has not been fetched.
    """
    return _extractor(detector, descriptor, STORED_COUNT, "strongest")


def scene_extractor(detector: str, descriptor: str) -> FeatureExtractor:
    """The extractor for images that are searched: features everywhere, also where they are weak.

    Raises:
        ConfigError: there is none of this name, this installation lacks it, or the names do not go
            together.
        ModelError: its model has not been fetched.
    """
    return _extractor(detector, descriptor, SCENE_COUNT, "grid")


def _extractor(detector: str, descriptor: str, count: int, selection: str) -> FeatureExtractor:
    chosen = {
        "detector": detector,
        "descriptor": descriptor,
        "count": count,
        "levels": _LEVELS,
        "selection": selection,
    }
    return make_extractor(validate(FeaturesConfig, chosen, "the features of objects"))


def extract(extractor: FeatureExtractor, image: Bytes) -> SceneFeatures:
    """Features of an (H, W) uint8 image."""
    found: Keypoints = extractor.extract(evenly_lit(image))
    size = np.float32(extractor.scale_factor) ** found.octave.astype(np.float32)
    vectors = unit_vectors(found.descriptor)
    return SceneFeatures(found.xy, found.angle, size, found.descriptor, vectors)


def strongest_of_each_size(found: SceneFeatures) -> SceneFeatures:
    """The strongest features of each octave of sizes: seen from afar, only large ones are left."""
    octave = np.floor(np.log2(np.maximum(found.size, 1.0)) + 1e-3).astype(np.int64)
    kept = np.zeros(len(found), bool)
    for each in np.unique(octave).tolist():
        kept[np.flatnonzero(octave == each)[:_STORED_OF_SIZE]] = True
    return found.select(np.flatnonzero(kept))


def evenly_lit(image: Bytes) -> Bytes:
    """An image with the contrast of dark and pale parts raised, linearly within small parts.

    Descriptors tolerate linear changes; detectors find nothing where contrast is low.
    """
    size = image.shape[1], image.shape[0]
    small = [max(1, side // _STEP_PX) for side in size]
    values = image.astype(np.float32)
    means = [cv2.resize(each, small, interpolation=cv2.INTER_AREA) for each in (values, values**2)]
    means = [cv2.GaussianBlur(each, (0, 0), _NEIGHBOURHOOD_PX / _STEP_PX) for each in means]
    mean, square = (cv2.resize(each, size, interpolation=cv2.INTER_LINEAR) for each in means)
    variance = square - mean * mean
    gain = np.minimum(_CONTRAST / np.sqrt(np.maximum(variance, 1e-6)), _MAX_GAIN)
    even = np.clip(np.rint(128.0 + gain * (values - mean)), 0, 255)
    return np.asarray(even, dtype=np.uint8)


def unit_vectors(descriptor: Descriptors) -> Floats32:
    """(N, d) float32 of length 1, in which Hamming and Euclidean distances alike are angles.

    A bit becomes 1 or -1: of two binary descriptors of n bits that differ in h, the squared
    distance is 4 h / n.
    """
    if descriptor.dtype == np.uint8:
        bits = np.unpackbits(np.ascontiguousarray(descriptor), axis=1).astype(np.float32)
        return np.asarray((2.0 * bits - 1.0) / np.sqrt(np.float32(bits.shape[1])))
    values = np.asarray(descriptor, dtype=np.float32)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(values / np.maximum(length, np.float32(1e-12)))


def compact(descriptor: Descriptors) -> Descriptors:
    """Descriptors as they are stored: float ones as int8, relative to their largest element."""
    if descriptor.dtype == np.uint8:
        return descriptor
    values = np.asarray(descriptor, dtype=np.float32)
    largest = np.abs(values).max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(np.rint(127.0 * values / np.maximum(largest, 1e-12)), dtype=np.int8)


def codes(vector: Floats32, centre: Floats32) -> Codes:
    """(N, 4) uint64: signs of 256 projections of unit vectors (N, width) minus a centre.

    The angle between two vectors is proportional to the bits in which their codes differ, on
    average.

    Source: Charikar, "Similarity estimation techniques from rounding algorithms", STOC 2002; Ji et
    al., "Super-bit locality-sensitive hashing", NIPS 2012 (orthogonal projections).
    """
    bits = (vector - centre) @ _projections(vector.shape[1]) > 0
    return np.packbits(bits, axis=1).view(np.uint64)


@cache
def _projections(width: int) -> Floats32:
    """(width, 256) directions, those of each group of `width` orthogonal."""
    random = np.random.default_rng(_SEED)
    groups = -(-CODE_BITS // width)
    parts = [np.linalg.qr(random.standard_normal((width, width)))[0] for _ in range(groups)]
    return np.concatenate(parts, axis=1)[:, :CODE_BITS].astype(np.float32)
