"""Feature extraction from a detector, a selection and a descriptor, chosen by name."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from vo.base.config import FeaturesConfig
from vo.base.errors import ConfigError
from vo.base.feature_settings import OWN_NETWORK
from vo.base.types import Bytes, Floats32, Keypoints
from vo.engine.features.descriptors import DESCRIPTORS, Described, Descriptor, make_descriptor
from vo.engine.features.detections import Detector
from vo.engine.features.detectors import DETECTORS
from vo.engine.features.pyramid import PyramidDetector
from vo.engine.features.selection import Selection, select
from vo.engine.frontend.contracts import DescriptorFormat, FeatureExtractor, PointDescriber

_CLAHE_CLIP, _CLAHE_TILES = 3.0, (8, 8)
_MAX_OCTAVE = 24
_REFINE_HALF_PX = 3
_REFINE_STEPS, _REFINE_PX = 20, 0.01
_MAX_REFINEMENT_PX = 3.0
_SAME_PX = 0.5  # corners that end this near to each other are the same


class ComposedExtractor:
    """Detects, selects, refines and describes, as a `FeatureExtractor`."""

    def __init__(self, detector: Detector, descriptor: Descriptor, config: FeaturesConfig) -> None:
        self._detector = detector
        self._descriptor = descriptor
        self._config = config
        self._selection: Selection = config.selection

    @property
    def descriptor_format(self) -> DescriptorFormat:
        """Layout of the descriptors."""
        return self._descriptor.format

    @property
    def scale_factor(self) -> float:
        """Size ratio of two octaves; scales in between are rounded."""
        return self._config.scale_factor if self._detector.has_scale else 1.0

    @property
    def base_size(self) -> float:
        """Diameter in pixels of what is detected in octave 0."""
        return self._detector.base_size

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """Features of an (H, W) uint8 image, strongest first."""
        if self._config.clahe:
            image = _equalised(image)
        found = self._detector.detect(np.ascontiguousarray(image), mask)
        found = found.select(self._descriptor.fits(image.shape, found))
        found = select(found, self._config.count, image.shape, self._selection)
        if self._config.subpixel:
            found = replace(found, xy=_refined(image, found.xy))
            _, first = np.unique(np.rint(found.xy / _SAME_PX), axis=0, return_index=True)
            found = found.select(np.sort(first))
        described = self._descriptor.describe(image, found)
        return self._keypoints(described)

    def _keypoints(self, described: Described) -> Keypoints:
        found = described.detections
        octave = np.zeros(len(found), np.int32)
        if self._detector.has_scale:
            ratio = np.maximum(found.size / self._detector.base_size, 1.0)
            steps = np.rint(np.log(ratio) / np.log(self._config.scale_factor))
            octave = np.minimum(steps, _MAX_OCTAVE).astype(np.int32)
        return Keypoints(found.xy, octave, found.angle, found.response, described.descriptor)


def make_extractor(config: FeaturesConfig) -> FeatureExtractor:
    """The extractor that the settings name.

    Raises:
        ConfigError: this build of OpenCV lacks it, or detector and descriptor do not go together.
    """
    if config.detector.startswith(OWN_NETWORK):
        from vo.engine.learned.own_network import load_own_network

        _check_own_descriptor(config, "")
        path = Path(config.detector.removeprefix(OWN_NETWORK)).expanduser()
        return load_own_network(path, config.backend, config.device, config.count)
    kind = DETECTORS[config.detector]
    if kind.extract is not None:
        _check_own_descriptor(config, kind.descriptor)
        return kind.extract(config)
    assert kind.find is not None
    name = kind.descriptor if config.descriptor == "auto" else config.descriptor
    allowed = DESCRIPTORS[name].detectors
    if allowed and config.detector not in allowed:
        raise ConfigError(
            f"descriptor '{name}' needs detector {' or '.join(repr(d) for d in allowed)}, not "
            f"'{config.detector}'; try rootsift or rbrief"
        )
    detector = kind.find(config)
    if not detector.has_scale and config.levels > 1:
        detector = PyramidDetector(detector, config.levels, config.scale_factor)
    return ComposedExtractor(detector, make_descriptor(name, detector.base_size), config)


def make_rescuer(config: FeaturesConfig) -> PointDescriber:
    """The extractor that `features.rescue` names, if its file is as it was made.

    Raises:
        ModelError: it is missing, or was changed.
    """
    from vo.engine.learned.catalog import find_model
    from vo.engine.learned.files import verify

    verify(find_model(config.rescue))
    chosen = config.model_copy(update={"detector": config.rescue})
    return cast("PointDescriber", make_extractor(chosen))


def _check_own_descriptor(config: FeaturesConfig, own: str) -> None:
    if config.descriptor not in ("auto", own):
        hint = "; for FAST corners with another one choose features.detector=fast" if own else ""
        raise ConfigError(
            f"features.detector '{config.detector}' has its own descriptor, not "
            f"'{config.descriptor}'{hint}"
        )


def _equalised(image: Bytes) -> Bytes:
    """Contrast-limited adaptive histogram equalisation (Zuiderveld 1994)."""
    return np.asarray(cv2.createCLAHE(_CLAHE_CLIP, _CLAHE_TILES).apply(image))


def _refined(image: Bytes, xy: Floats32) -> Floats32:
    """Corners moved to where gradients around them meet; those that move far stay."""
    if len(xy) == 0:
        return xy
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _REFINE_STEPS, _REFINE_PX)
    window = (_REFINE_HALF_PX, _REFINE_HALF_PX)
    moved = cv2.cornerSubPix(image, xy.reshape(-1, 1, 2).copy(), window, (-1, -1), criteria)
    moved = moved.reshape(-1, 2)
    is_near = np.hypot(*(moved - xy).T) <= _MAX_REFINEMENT_PX
    return np.where(is_near[:, None], moved, xy).astype(np.float32)
