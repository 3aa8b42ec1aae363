"""Detectors: Harris, Shi-Tomasi, FAST, AGAST, ORB, SIFT, MSER, AKAZE, KAZE, BRISK, SURF, ..."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np

from vo.base.types import Bytes
from vo.engine.features.detections import Detections, Detector, at_points, from_opencv
from vo.engine.features.opencv import has_algorithm, require_algorithm

CORNER_SIZE_PX = 7.0
"""Diameter of FAST's ring of pixels."""

_BLOCK_PX = 5  # side of the window that corner measures sum over
_CORNER_QUALITY = 0.005  # of the strongest corner's response
_CORNER_DISTANCE_PX = 3.0
_HARRIS_K = 0.04
_SMALLEST_PX = 16
_REGION_AREA_PX = 30  # of the smallest region of MSER
_REGION_SIZE_PX = 6.2  # the diameter of a disc of that area


@dataclass(frozen=True)
class DetectorOptions:
    """Options that detectors have in common.

    Attributes:
        count: features wanted; detectors find more, of which some are selected.
        threshold: minimum contrast of a corner in grey levels (FAST, AGAST, ORB, BRISK).
    """

    count: int = 1500
    threshold: int = 20


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

    def __init__(self, options: DetectorOptions, *, harris: bool) -> None:
        self._count = 4 * options.count
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
    """A detector by name.

    Attributes:
        make: creates it.
        descriptor: the descriptor that goes with it by default.
        algorithm: name of the algorithm in OpenCV that it needs, empty for none.
        summary: one line of explanation.
    """

    make: Callable[[DetectorOptions], Detector]
    descriptor: str
    algorithm: str
    summary: str


def _opencv(
    algorithm: str,
    descriptor: str,
    summary: str,
    base_size: float,
    arguments: Callable[[DetectorOptions], dict[str, Any]] = lambda _: {},
    *,
    has_scale: bool = True,
) -> DetectorKind:
    def make(options: DetectorOptions) -> Detector:
        create = require_algorithm(algorithm, f"detector '{_NAMES[algorithm]}'")
        given = arguments(options)
        return OpenCvDetector(lambda: create(**given), base_size=base_size, has_scale=has_scale)

    return DetectorKind(make, descriptor, algorithm, summary)


DETECTORS: dict[str, DetectorKind] = {
    "harris": DetectorKind(
        lambda options: CornerDetector(options, harris=True),
        "rbrief",
        "",
        "corners by det - k trace^2 of the gradient matrix, on a pyramid",
    ),
    "shi_tomasi": DetectorKind(
        lambda options: CornerDetector(options, harris=False),
        "rbrief",
        "",
        "corners by the smaller eigenvalue of the gradient matrix, on a pyramid",
    ),
    "fast": _opencv(
        "FastFeatureDetector",
        "rbrief",
        "corners by a ring of brighter or darker pixels, on a pyramid",
        CORNER_SIZE_PX,
        lambda options: {"threshold": options.threshold},
        has_scale=False,
    ),
    "agast": _opencv(
        "AgastFeatureDetector",
        "rbrief",
        "FAST with decision trees that adapt to the image, on a pyramid",
        CORNER_SIZE_PX,
        lambda options: {"threshold": options.threshold},
        has_scale=False,
    ),
    "opencv_orb": _opencv(
        "ORB",
        "opencv_orb",
        "OpenCV's ORB: FAST on a pyramid, ranked by Harris, with orientation",
        31.0,
        lambda options: {"nfeatures": 2 * options.count, "fastThreshold": options.threshold},
    ),
    "sift": _opencv(
        "SIFT", "rootsift", "extrema of differences of Gaussians, with scale and orientation", 3.2
    ),
    "mser": _opencv(
        "MSER",
        "sift",
        "regions that stay the same over many thresholds",
        _REGION_SIZE_PX,
        # OpenCV's defaults (delta 5, 60 pixels, diversity 0.2) find a tenth: too few for odometry.
        lambda _: {"delta": 2, "min_area": _REGION_AREA_PX, "min_diversity": 0.1},
    ),
    "akaze": _opencv(
        "AKAZE", "akaze", "blobs of a nonlinear scale space, fast, binary descriptor", 4.8
    ),
    "kaze": _opencv("KAZE", "kaze", "blobs of a nonlinear scale space", 4.8),
    "brisk": _opencv(
        "BRISK",
        "brisk",
        "AGAST on a pyramid with interpolated scale",
        8.4,
        lambda options: {"thresh": options.threshold},
    ),
    "star": _opencv("StarDetector", "rbrief", "CenSurE: centre-surround blobs", 6.0),
    "surf": _opencv("SURF", "surf", "blobs by box filters; patented", 15.0),
}
"""Detectors by name, besides `orb`, the built-in extractor of `vo run`."""

_NAMES = {kind.algorithm: name for name, kind in DETECTORS.items() if kind.algorithm}


def available_detectors() -> list[str]:
    """Names of the detectors that this installation has."""
    return [
        n for n, kind in DETECTORS.items() if not kind.algorithm or has_algorithm(kind.algorithm)
    ]
