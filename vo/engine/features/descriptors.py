"""Descriptors: rBRIEF, BRIEF, SIFT, RootSIFT, AKAZE, KAZE, BRISK, ORB, FREAK, LATCH, DAISY, ..."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from vo.base.types import Bools, Bytes, Descriptors, Floats, Floats32
from vo.engine.features.detections import Detections, from_opencv
from vo.engine.features.opencv import has_algorithm, require_algorithm
from vo.engine.features.pyramid import pyramid_levels, to_level
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.frontend.orb import BORDER_PX, describe_corners

_RBRIEF_SIZE_PX = 31.0  # of the patch that it compares pixels of, at its own level
_RBRIEF_FACTOR = 1.2  # between the levels that it chooses from
_RBRIEF_LEVELS = 16
_INDEX = 1 << 20  # class_id of the first keypoint: OpenCV keeps it, also if it drops or adds some


class Described(NamedTuple):
    """Detections with their descriptors; those too close to the border are left out.

    Attributes:
        detections: (n,), with the orientation that the descriptor has used.
        descriptor: (n, width).
    """

    detections: Detections
    descriptor: Descriptors


class Descriptor(Protocol):
    """Describes the neighbourhoods of detected places."""

    @property
    def format(self) -> DescriptorFormat:
        """Layout of the descriptors."""
        ...

    def fits(self, shape: tuple[int, ...], detections: Detections) -> Bools:
        """(N,) places known to be far enough from the border of an image of shape (H, W)."""
        ...

    def describe(self, image: Bytes, detections: Detections) -> Described:
        """Descriptors of places in an (H, W) uint8 image."""
        ...


class RotatedBrief:
    """Rotated BRIEF at the pyramid level that suits the size of a detection.

    Source: Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011, section 4.
    """

    format = DescriptorFormat(32, np.dtype(np.uint8))

    def __init__(self, base_size: float) -> None:
        self._base_size = base_size

    def fits(self, shape: tuple[int, ...], detections: Detections) -> Bools:
        """See `Descriptor.fits`."""
        steps = np.rint(self._level(detections.size))
        border = (BORDER_PX + 1.0) * _RBRIEF_FACTOR**steps
        size = np.array(shape[1::-1])
        edge = np.minimum(detections.xy, size - 1 - detections.xy).min(axis=1, initial=np.inf)
        return np.asarray(edge >= border)

    def _level(self, size: Floats32) -> Floats:
        ratio = np.maximum(size / self._base_size, 1.0)
        return np.asarray(np.log(ratio) / np.log(_RBRIEF_FACTOR), dtype=np.float64)

    def describe(self, image: Bytes, detections: Detections) -> Described:
        """See `Descriptor.describe`."""
        level = np.rint(self._level(detections.size)).astype(np.int64)
        rows, angles, descriptors = [], [], []
        levels = pyramid_levels(image, _RBRIEF_LEVELS, _RBRIEF_FACTOR)
        level = np.minimum(level, len(levels) - 1)
        for number in sorted(set(level.tolist())):
            scaled = levels[number]
            here = np.flatnonzero(level == number)
            xy = np.rint(to_level(detections.xy[here], scaled, image)).astype(np.int32)
            size = np.array(scaled.shape[::-1])
            inside = ((xy >= BORDER_PX) & (xy < size - BORDER_PX)).all(axis=1)
            angle, descriptor = describe_corners(scaled, xy[inside])
            rows.append(here[inside])
            angles.append(angle)
            descriptors.append(descriptor)
        if not rows:
            return Described(detections, np.empty((0, 32), np.uint8))
        order = np.argsort(np.concatenate(rows))
        kept = detections.select(np.concatenate(rows)[order])
        angle = np.concatenate(angles)[order]
        return Described(replace(kept, angle=angle), np.concatenate(descriptors)[order])


class OpenCvDescriptor:
    """A descriptor of OpenCV; each thread has an object of its own.

    Args:
        finish: changes the descriptors, None to leave them.
        keeps_class: whether it needs the class that its own detector has given.
    """

    def __init__(
        self,
        make: Callable[[], Any],
        finish: Callable[[Floats32], Floats32] | None = None,
        *,
        keeps_class: bool = False,
    ) -> None:
        self._make = make
        self._finish = finish
        self._keeps_class = keeps_class
        self._local = threading.local()
        sample = make()
        dtype = np.dtype(np.uint8 if sample.descriptorType() == 0 else np.float32)
        self.format = DescriptorFormat(sample.descriptorSize(), dtype)

    def fits(self, shape: tuple[int, ...], detections: Detections) -> Bools:
        """All: OpenCV's descriptors leave out what does not fit, each in its own way."""
        return np.ones(len(detections), dtype=bool)

    def describe(self, image: Bytes, detections: Detections) -> Described:
        """See `Descriptor.describe`."""
        describer = getattr(self._local, "describer", None)
        if describer is None:
            describer = self._local.describer = self._make()
        keypoints = detections.as_opencv()
        if not self._keeps_class:
            for number, keypoint in enumerate(keypoints):
                keypoint.class_id = _INDEX + number
        kept, descriptor = describer.compute(image, keypoints) if keypoints else ((), None)
        if descriptor is None or len(kept) == 0:
            empty = np.empty((0, self.format.width), self.format.dtype)
            return Described(detections.select(np.empty(0, np.int64)), empty)
        found = from_opencv(kept)
        if not self._keeps_class:
            rows = found.class_id.astype(np.int64) - _INDEX
            found = replace(detections.select(rows), angle=found.angle)
        if self._finish is not None:
            descriptor = self._finish(descriptor)
        return Described(found, descriptor)


def root_sift(descriptor: Floats32) -> Floats32:
    """RootSIFT: square roots of the descriptors scaled to a sum of one.

    Their Euclidean distance is the Hellinger distance of the histograms.

    Source: Arandjelovic and Zisserman, "Three things everyone should know to improve object
    retrieval", CVPR 2012.
    """
    total = np.maximum(descriptor.sum(axis=1, keepdims=True), 1e-7)
    return np.asarray(np.sqrt(descriptor / total), dtype=np.float32)


class DescriptorKind(NamedTuple):
    """A descriptor by name.

    Attributes:
        algorithm: name of the algorithm in OpenCV that it needs, empty for none.
        detectors: the detectors that it works with; empty for all.
    """

    algorithm: str
    summary: str
    detectors: tuple[str, ...] = ()
    finish: Callable[[Floats32], Floats32] | None = None


_SCALE_SPACE = ("akaze", "kaze")
# By default OpenCV's SIFT is off by 0.25 px in both directions.
PRECISE_SIFT = {"enable_precise_upscale": True}

DESCRIPTORS: dict[str, DescriptorKind] = {
    "rbrief": DescriptorKind("", "rotated BRIEF, 256 bits, as `vo run` uses it"),
    "brief": DescriptorKind("BriefDescriptorExtractor", "BRIEF, 256 bits, without rotation"),
    "sift": DescriptorKind("SIFT", "128 histogram bins of gradients"),
    "rootsift": DescriptorKind("SIFT", "square roots of SIFT's bins", finish=root_sift),
    "opencv_orb": DescriptorKind("ORB", "OpenCV's rotated BRIEF, 256 bits", ("opencv_orb",)),
    "akaze": DescriptorKind("AKAZE", "M-LDB, 486 bits", ("akaze",)),
    "kaze": DescriptorKind("KAZE", "64 gradient sums of a nonlinear scale space", ("kaze",)),
    "brisk": DescriptorKind("BRISK", "512 comparisons of a ring pattern"),
    "freak": DescriptorKind("FREAK", "512 comparisons of a retinal pattern"),
    "latch": DescriptorKind("LATCH", "256 comparisons of triplets of patches"),
    "daisy": DescriptorKind("DAISY", "200 gradient histogram bins, dense"),
    "surf": DescriptorKind("SURF", "64 sums of Haar wavelets; patented"),
}
"""Descriptors by name."""


def make_descriptor(name: str, base_size: float) -> Descriptor:
    """A descriptor.

    Args:
        name: a key of `DESCRIPTORS`.
        base_size: diameter in pixels of what the detector finds at its finest scale.

    Raises:
        ConfigError: this build of OpenCV does not have it.
    """
    kind = DESCRIPTORS[name]
    if not kind.algorithm:
        return RotatedBrief(base_size)
    create = require_algorithm(kind.algorithm, f"descriptor '{name}'")
    if kind.algorithm == "SIFT":
        create = partial(create, **PRECISE_SIFT)
    return OpenCvDescriptor(create, kind.finish, keeps_class=name in (*_SCALE_SPACE, "opencv_orb"))


def available_descriptors() -> list[str]:
    """Names of the descriptors that this installation has."""
    return [
        n for n, kind in DESCRIPTORS.items() if not kind.algorithm or has_algorithm(kind.algorithm)
    ]
