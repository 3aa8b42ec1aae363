"""A way to find the same places in two images: features that are matched, or optical flow.

Methods are written `DETECTOR[+DESCRIPTOR][/MATCHER]`: `orb`, `sift`, `fast+brisk`, `sift/flann`;
`klt` is `shi_tomasi/klt`, corners that are followed by optical flow instead of being described.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple, Protocol, get_args

import numpy as np

from vo.base.config import (
    DescriptorName,
    FeaturesConfig,
    MatchingConfig,
    MatchingName,
)
from vo.base.errors import ConfigError
from vo.base.feature_settings import OWN_NETWORK
from vo.base.types import Bytes, Floats, Keypoints
from vo.engine.features.detections import Detections, Detector
from vo.engine.features.detectors import CORNER_SIZE_PX, DETECTORS, available_detectors
from vo.engine.features.extractor import ComposedExtractor, make_extractor
from vo.engine.features.matching import make_matcher
from vo.engine.features.selection import select
from vo.engine.frontend.contracts import feature_set
from vo.engine.frontend.optical_flow import follow
from vo.engine.learned.inference import networks_used

KLT = "klt"
MATCHERS = (*get_args(MatchingName), KLT)


class PairMatches(NamedTuple):
    """Matches of two images."""

    first: Floats  # (n, 2) pixels in the first image
    second: Floats  # (n, 2) pixels in the second image
    counts: tuple[int, int]  # number of features in the first and in the second image
    extract_ms: float  # CPU time of detection and description in both images
    match_ms: float  # CPU time of matching


class Method(Protocol):
    """Finds the same places in two images."""

    @property
    def name(self) -> str:
        """How it is written."""
        ...

    @property
    def needs_one_size(self) -> bool:
        """Whether both images must be of the same size."""
        ...

    def match(self, first: Bytes, second: Bytes, mask: Bytes | None = None) -> PairMatches:
        """Matches of two (H, W) uint8 images; no feature of the first lies where `mask` is 0."""
        ...

    def detect(self, image: Bytes, mask: Bytes | None = None) -> Floats:
        """(N, 2) pixels of the features in an (H, W) uint8 image."""
        ...

    def extract(self, image: Bytes, mask: Bytes | None = None) -> Keypoints:
        """Features of an (H, W) uint8 image; without descriptors if it needs none."""
        ...

    def sizes(self, keypoints: Keypoints) -> Floats:
        """(N,) diameters in pixels of what was detected."""
        ...


class DescribedFeatures:
    """Features that are matched by their descriptors."""

    needs_one_size = False

    def __init__(self, name: str, features: FeaturesConfig, matching: MatchingConfig) -> None:
        self.name = name
        with networks_used(features.device):
            self._extractor = make_extractor(features)
        self._matcher = make_matcher(matching, self._extractor, features)

    def match(self, first: Bytes, second: Bytes, mask: Bytes | None = None) -> PairMatches:
        """See `Method.match`."""
        begin = time.process_time()
        a, b = self._extractor.extract(first, mask), self._extractor.extract(second)
        extracted = time.process_time()
        query, train = (
            feature_set(each, size=(image.shape[1], image.shape[0]))
            for each, image in ((a, first), (b, second))
        )
        matches = self._matcher.match(query, train)
        end = time.process_time()
        return PairMatches(
            a.xy[matches.query].astype(np.float64),
            b.xy[matches.train].astype(np.float64),
            (len(a), len(b)),
            1e3 * (extracted - begin),
            1e3 * (end - extracted),
        )

    def extract(self, image: Bytes, mask: Bytes | None = None) -> Keypoints:
        """See `Method.extract`."""
        return self._extractor.extract(image, mask)

    def sizes(self, keypoints: Keypoints) -> Floats:
        """See `Method.sizes`."""
        extractor = self._extractor
        base = extractor.base_size if isinstance(extractor, ComposedExtractor) else CORNER_SIZE_PX
        return np.asarray(base * extractor.scale_factor ** keypoints.octave.astype(np.float64))

    def detect(self, image: Bytes, mask: Bytes | None = None) -> Floats:
        """See `Method.detect`."""
        return self.extract(image, mask).xy.astype(np.float64)


class FollowedCorners:
    """Corners of the first image, followed into the second by optical flow."""

    needs_one_size = True

    def __init__(self, name: str, detector: Detector, features: FeaturesConfig) -> None:
        self.name = name
        self._detector = detector
        self._config = features

    def match(self, first: Bytes, second: Bytes, mask: Bytes | None = None) -> PairMatches:
        """See `Method.match`.

        Raises:
            ConfigError: the images differ in size.
        """
        if first.shape != second.shape:
            raise ConfigError(
                f"optical flow needs images of one size, not {_size(first)} and {_size(second)}"
            )
        begin = time.process_time()
        xy = self.detect(first, mask)
        extracted = time.process_time()
        flow = follow(first, second, xy, xy)
        end = time.process_time()
        return PairMatches(
            xy[flow.found],
            flow.xy[flow.found],
            (len(xy), len(xy)),
            1e3 * (extracted - begin),
            1e3 * (end - extracted),
        )

    def detect(self, image: Bytes, mask: Bytes | None = None) -> Floats:
        """See `Method.detect`."""
        return self._select(image, mask).xy.astype(np.float64)

    def extract(self, image: Bytes, mask: Bytes | None = None) -> Keypoints:
        """See `Method.extract`."""
        found = self._select(image, mask)
        nothing = np.empty((len(found), 0), np.uint8)
        octave = np.zeros(len(found), np.int32)
        return Keypoints(found.xy, octave, found.angle, found.response, nothing)

    def sizes(self, keypoints: Keypoints) -> Floats:
        """See `Method.sizes`."""
        return np.full(len(keypoints), self._detector.base_size)

    def _select(self, image: Bytes, mask: Bytes | None) -> Detections:
        found = self._detector.detect(image, mask)
        return select(found, self._config.count, image.shape, self._config.selection)


def make_method(text: str, features: FeaturesConfig, matching: MatchingConfig) -> Method:
    """The method that a text names.

    `text`: `DETECTOR[+DESCRIPTOR][/MATCHER]`, or `klt`. `features`: count and other settings of all
    methods. `matching`: ratio and other settings of all methods.

    Raises:
        ConfigError: there is no such method, or this build of OpenCV lacks it.
    """
    if text.startswith(OWN_NETWORK):
        return _own_network(text, features, matching)
    written = f"shi_tomasi/{KLT}" if text == KLT else text
    rest, _, matcher = written.partition("/")
    detector, _, descriptor = rest.partition("+")
    _check(text, detector, (*DETECTORS, KLT), "detector")
    if detector == KLT:
        raise ConfigError(f"method '{text}': write {KLT} alone, or DETECTOR/{KLT}")
    _check(text, matcher or "auto", MATCHERS, "matcher")
    if matcher == KLT:
        if descriptor:
            raise ConfigError(f"method '{text}': optical flow needs no descriptor; leave it out")
        return FollowedCorners(text, _corner_detector(text, detector, features), features)
    _check(text, descriptor or "auto", get_args(DescriptorName), "descriptor")
    chosen = {"detector": detector, "descriptor": descriptor or "auto"}
    return DescribedFeatures(
        text,
        features.model_copy(update=chosen),
        matching.model_copy(update={"method": matcher}) if matcher else matching,
    )


def _own_network(text: str, features: FeaturesConfig, matching: MatchingConfig) -> Method:
    """Features of a file, whose path may contain `/` itself."""
    path, _, matcher = text.rpartition("/")
    if matcher in get_args(MatchingName):
        matching = matching.model_copy(update={"method": matcher})
    else:
        path = text
    return DescribedFeatures(text, features.model_copy(update={"detector": path}), matching)


def expand(texts: Sequence[str]) -> list[str]:
    """Names of methods; `all` stands for every detector of this installation, and more."""
    expanded: list[str] = []
    for text in texts:
        expanded += all_methods() if text == "all" else [text]
    return list(dict.fromkeys(expanded))


def missing_detectors() -> list[str]:
    """Names of the detectors that this installation lacks."""
    available = available_detectors()
    return [n for n, kind in DETECTORS.items() if kind.find is not None and n not in available]


def all_methods() -> list[str]:
    """Every detector with its own descriptor, optical flow, and ORB and SIFT with each matcher."""
    detectors = ["orb", *available_detectors(), *fetched_methods()]
    return [*detectors, KLT, f"fast/{KLT}", "sift/flann", "sift/ann", "orb/flann", "orb/ann"]


def fetched_methods() -> list[str]:
    """Learned features whose model is on this machine, also with the matchers that are."""
    from vo.engine.learned.catalog import find_model
    from vo.engine.learned.files import path_of

    def is_here(model: str) -> bool:
        return path_of(find_model(model)).is_file()

    # One name for each model: the last of those that have several.
    learned = {k.model: n for n, k in DETECTORS.items() if k.model and is_here(k.model)}
    return list(learned.values()) + [
        f"{name}/{matcher}"
        for name in learned.values()
        for matcher, model in DETECTORS[name].matchers.items()
        if is_here(model)
    ]


def _corner_detector(text: str, name: str, features: FeaturesConfig) -> Detector:
    find = DETECTORS[name].find
    if find is None:
        raise ConfigError(f"method '{text}': choose corners such as fast/{KLT} or shi_tomasi/{KLT}")
    return find(features)


def _check(text: str, name: str, known: Sequence[str], what: str) -> None:
    if name not in known:
        raise ConfigError(
            f"method '{text}': there is no {what} '{name}'; known are {', '.join(known)}"
        )


def _size(image: Bytes) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"
