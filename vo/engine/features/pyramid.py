"""Scale for detectors that have none: detection on an image pyramid."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from vo.base.types import Bools, Bytes, Floats32, Ints
from vo.engine.features.detections import Detections, Detector, joined

_SMALLEST_PX = 40  # side of the smallest level
_DUPLICATE_PX = 1.5  # distance of the same corner on two levels, in pixels of the coarser one


def pyramid_levels(image: Bytes, levels: int, factor: float) -> list[Bytes]:
    """The image and smaller ones, each by a factor; fewer than asked for if they get too small."""
    height, width = image.shape
    images = [np.ascontiguousarray(image)]
    for level in range(1, levels):
        size = round(width / factor**level), round(height / factor**level)
        if min(size) < _SMALLEST_PX:
            break
        images.append(np.asarray(cv2.resize(images[-1], size, interpolation=cv2.INTER_LINEAR)))
    return images


def to_full(xy: Floats32, level: Bytes, full: Bytes) -> Floats32:
    """Pixels of a level as pixels of the full image.

    Pixel centres lie at whole numbers: pixel p of a level covers (p + 1/2) s - 1/2 of the image.
    """
    scale = np.array(full.shape[::-1]) / level.shape[::-1]
    return np.asarray(((xy + 0.5) * scale - 0.5), dtype=np.float32)


def to_level(xy: Floats32, level: Bytes, full: Bytes) -> Floats32:
    """Pixels of the full image as pixels of a level; the inverse of `to_full`."""
    scale = np.array(level.shape[::-1]) / full.shape[::-1]
    return np.asarray(((xy + 0.5) * scale - 0.5), dtype=np.float32)


class PyramidDetector:
    """Runs a detector of one scale on every level, merges the results and removes duplicates."""

    has_scale = True

    def __init__(self, detector: Detector, levels: int, factor: float) -> None:
        self.base_size = detector.base_size
        self._detector = detector
        self._levels = levels
        self._factor = factor

    def detect(self, image: Bytes, mask: Bytes | None = None) -> Detections:
        """See `vo.engine.features.detections.Detector.detect`."""
        parts = []
        for octave, level in enumerate(pyramid_levels(image, self._levels, self._factor)):
            found = self._detector.detect(level, _mask_of(mask, level))
            parts.append(
                replace(
                    found,
                    xy=to_full(found.xy, level, image),
                    size=found.size * np.float32(self._factor**octave),
                    packed_octave=np.full(len(found), octave, np.int32),
                )
            )
        every = joined(parts)
        return every.select(~_duplicates(every, self._factor)).in_fixed_order()


def _mask_of(mask: Bytes | None, level: Bytes) -> Bytes | None:
    if mask is None or mask.shape == level.shape:
        return mask
    size = level.shape[1], level.shape[0]
    return np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST))


def _duplicates(found: Detections, factor: float) -> Bools:
    """(N,) detections that lie on a stronger one of an adjacent level."""
    result = np.zeros(len(found), dtype=bool)
    octaves = sorted(set(found.packed_octave.tolist()))
    for fine, coarse in zip(octaves, octaves[1:], strict=False):
        a = np.flatnonzero(found.packed_octave == fine)
        b = np.flatnonzero(found.packed_octave == coarse)
        near_a, near_b = _pairs_within(found.xy[a], found.xy[b], _DUPLICATE_PX * factor**coarse)
        weaker_a = found.response[a[near_a]] < found.response[b[near_b]]
        result[a[near_a[weaker_a]]] = True
        result[b[near_b[~weaker_a]]] = True
    return result


def _pairs_within(a: Floats32, b: Floats32, reach: float) -> tuple[Ints, Ints]:
    """Rows of all pairs of points (n, 2) and (m, 2) that lie within a distance."""
    order = np.argsort(b[:, 0], kind="stable")
    u = b[order, 0]
    first, last = np.searchsorted(u, a[:, 0] - reach), np.searchsorted(u, a[:, 0] + reach, "right")
    counts = last - first
    rows = np.repeat(np.arange(len(a)), counts)
    offsets = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    others = order[np.repeat(first, counts) + offsets]
    near = np.hypot(*(a[rows] - b[others]).T) <= reach
    return rows[near], others[near]
