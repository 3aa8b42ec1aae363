"""Detectors by name, and what goes with each."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NamedTuple, cast

import cv2
import numpy as np

from vo.base.config import FeaturesConfig
from vo.base.types import Bytes
from vo.engine.features.descriptors import PRECISE_SIFT
from vo.engine.features.detections import Detections, Detector, at_points, from_opencv
from vo.engine.features.opencv import has_algorithm, require_algorithm
from vo.engine.frontend.contracts import FeatureExtractor
from vo.engine.frontend.orb import OrbExtractor

CORNER_SIZE_PX = 7.0
"""Diameter of FAST's ring of pixels."""

_BLOCK_PX = 5  # side of the window that corner measures sum over
_CORNER_QUALITY = 0.005  # of the strongest corner's response
_CORNER_DISTANCE_PX = 3.0
_HARRIS_K = 0.04
_SMALLEST_PX = 16
_REGION_AREA_PX = 30  # of the smallest region of MSER
_REGION_SIZE_PX = 6.2  # the diameter of a disc of that area


class OpenCvDetector:
    """A detector of OpenCV; each thread has an object of its own, as they are not thread-safe."""

    def __init__(self, make: Callable[[], Any], *, base_size: float, has_scale: bool) -> None:
        self.base_size = base_size
        self.has_scale = has_scale
        self._make = make
        self._local = threading.local()

    def detect(self, image: Bytes, mask: Bytes | None = None) -> Detections:
        """See `Detector.detect`."""
        if min(image.shape) < _SMALLEST_PX:  # some of them would raise an error
            return from_opencv(())
        detector = getattr(self._local, "detector", None)
        if detector is None:
            detector = self._local.detector = self._make()
        return from_opencv(detector.detect(image, mask)).in_fixed_order()


class CornerDetector:
    """Corners by the matrix of squared gradients, summed over a window.

    Shi-Tomasi takes its smaller eigenvalue (Shi and Tomasi, "Good features to track", CVPR 1994),
    Harris det - k trace^2 (Harris and Stephens, "A combined corner and edge detector", 1988).
    """

    base_size = CORNER_SIZE_PX
    has_scale = False

    def __init__(self, count: int, *, harris: bool) -> None:
        self._count = 4 * count  # of which some are selected
        self._harris = harris

    def detect(self, image: Bytes, mask: Bytes | None = None) -> Detections:
        """See `Detector.detect`."""
        corners, quality = cv2.goodFeaturesToTrackWithQuality(
            image,
            self._count,
            _CORNER_QUALITY,
            _CORNER_DISTANCE_PX,
            mask,
            blockSize=_BLOCK_PX,
            useHarrisDetector=self._harris,
            k=_HARRIS_K,
        )
        if corners is None:
            return at_points(np.empty((0, 2), np.float32), np.empty(0, np.float32), 1.0)
        return at_points(corners, quality.ravel(), CORNER_SIZE_PX).in_fixed_order()


class DetectorKind(NamedTuple):
    """All that is known of a detector, by its name in the settings; it finds or extracts.

    Attributes:
        descriptor: what describes its places by default; of an extractor the only one, if it has a
            name.
        find: creates what finds places, for any descriptor; None for an extractor of its own.
        extract: creates an extractor whose descriptor cannot be chosen; None for a detector.
        algorithm: name of the algorithm in OpenCV that it needs, empty for none.
        model: name of the network that it needs, empty for none.
        matchers: networks that match its features, by `matching.method`.
    """

    descriptor: str = ""
    find: Callable[[FeaturesConfig], Detector] | None = None
    extract: Callable[[FeaturesConfig], FeatureExtractor] | None = None
    algorithm: str = ""
    model: str = ""
    matchers: Mapping[str, str] = {}


def _opencv(
    name: str,
    algorithm: str,
    descriptor: str,
    base_size: float,
    arguments: Callable[[FeaturesConfig], dict[str, Any]] = lambda _: {},
    *,
    has_scale: bool = True,
) -> DetectorKind:
    def find(config: FeaturesConfig) -> Detector:
        create = require_algorithm(algorithm, f"detector '{name}'")
        given = arguments(config)
        return OpenCvDetector(lambda: create(**given), base_size=base_size, has_scale=has_scale)

    return DetectorKind(descriptor, find, algorithm=algorithm)


def _learned(module: str, name: str, model: str, **matchers: str) -> DetectorKind:
    """A class of `vo.engine.learned`, which is imported when it is used."""

    def extract(config: FeaturesConfig) -> FeatureExtractor:
        from vo.engine.learned.catalog import find_model
        from vo.engine.learned.files import require_model
        from vo.engine.learned.inference import load

        network = load(require_model(find_model(model)), config.backend, config.device)
        extractor = getattr(import_module(f"vo.engine.learned.{module}"), name)
        return cast("FeatureExtractor", extractor(network, config.count))

    return DetectorKind(extract=extract, model=model, matchers=matchers)


DETECTORS: dict[str, DetectorKind] = {
    "orb": DetectorKind("rbrief", extract=OrbExtractor),
    "xfeat": _learned("xfeat", "XFeatExtractor", "xfeat", lighterglue="lighterglue"),
    "aliked-t16": _learned("aliked", "AlikedExtractor", "aliked-t16"),
    "aliked": _learned("aliked", "AlikedExtractor", "aliked-t16"),
    "aliked-n16": _learned("aliked", "AlikedExtractor", "aliked-n16", lightglue="lightglue-aliked"),
    "disk": _learned("disk", "DiskExtractor", "disk", lightglue="lightglue-disk"),
    "superpoint": _learned(
        "superpoint",
        "SuperPointExtractor",
        "superpoint",
        lightglue="lightglue-superpoint",
        superglue="superglue",
    ),
    "harris": DetectorKind("rbrief", lambda config: CornerDetector(config.count, harris=True)),
    "shi_tomasi": DetectorKind("rbrief", lambda config: CornerDetector(config.count, harris=False)),
    "fast": _opencv(
        "fast",
        "FastFeatureDetector",
        "rbrief",
        CORNER_SIZE_PX,
        lambda config: {"threshold": config.threshold},
        has_scale=False,
    ),
    "agast": _opencv(
        "agast",
        "AgastFeatureDetector",
        "rbrief",
        CORNER_SIZE_PX,
        lambda config: {"threshold": config.threshold},
        has_scale=False,
    ),
    "opencv_orb": _opencv(
        "opencv_orb",
        "ORB",
        "opencv_orb",
        31.0,
        lambda config: {"nfeatures": 2 * config.count, "fastThreshold": config.threshold},
    ),
    "sift": _opencv("sift", "SIFT", "rootsift", 3.2, lambda _: PRECISE_SIFT),
    "mser": _opencv(
        "mser",
        "MSER",
        "sift",
        _REGION_SIZE_PX,
        # OpenCV's defaults (delta 5, 60 pixels, diversity 0.2) find a tenth: too few for odometry.
        lambda _: {"delta": 2, "min_area": _REGION_AREA_PX, "min_diversity": 0.1},
    ),
    "akaze": _opencv("akaze", "AKAZE", "akaze", 4.8),
    "kaze": _opencv("kaze", "KAZE", "kaze", 4.8),
    "brisk": _opencv("brisk", "BRISK", "brisk", 8.4, lambda config: {"thresh": config.threshold}),
    "star": _opencv("star", "StarDetector", "rbrief", 6.0),
    "surf": _opencv("surf", "SURF", "surf", 15.0),
}
"""Detectors by name. A new one needs an entry here, and its name in `DetectorName`."""


def available_detectors() -> list[str]:
    """Names of the detectors for any descriptor that this installation has."""
    return [
        name
        for name, kind in DETECTORS.items()
        if kind.find is not None and (not kind.algorithm or has_algorithm(kind.algorithm))
    ]
