"""ORB features: FAST on a pyramid, spread by a grid, with orientation and rotated BRIEF."""

from __future__ import annotations

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from vo.config import FeaturesConfig
from vo.features.fast import FastGrid
from vo.types import Bytes, Floats32, Keypoints

_PATCH = 31  # side of the described patch, at its pyramid level
_BORDER = 19  # room for the rotated patch and its blur


class OrbDetector:
    """Detects and describes; holds only its settings.

    Source: Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011.
    """

    def __init__(self, config: FeaturesConfig) -> None:
        self._config = config
        self._fast = FastGrid(config.threshold, config.low_threshold, _BORDER)
        self._describer = cv2.ORB.create(
            nfeatures=config.count, nlevels=1, edgeThreshold=_BORDER - 3, patchSize=_PATCH
        )
        self._disc = _disc_half_widths(_PATCH // 2)

    def detect(self, image: Bytes) -> Keypoints:
        """Keypoints of an (H, W) uint8 image, by pyramid level, then in scan order."""
        levels = [
            self._detect_level(level_image, octave, quota, image.shape)
            for octave, (level_image, quota) in enumerate(self._pyramid(image))
        ]
        return Keypoints(
            xy=np.concatenate([k.xy for k in levels]),
            octave=np.concatenate([k.octave for k in levels]),
            angle=np.concatenate([k.angle for k in levels]),
            response=np.concatenate([k.response for k in levels]),
            descriptor=np.concatenate([k.descriptor for k in levels]),
        )

    def _pyramid(self, image: Bytes) -> list[tuple[Bytes, int]]:
        factor = self._config.scale_factor
        shares = factor ** (-2.0 * np.arange(self._config.levels))
        quotas = np.round(self._config.count * shares / shares.sum()).astype(int)
        levels = [(np.ascontiguousarray(image), int(quotas[0]))]
        height, width = image.shape
        for octave in range(1, self._config.levels):
            size = (round(width / factor**octave), round(height / factor**octave))
            if min(size) <= 2 * _BORDER + 1:
                break
            smaller = cv2.resize(levels[-1][0], size, interpolation=cv2.INTER_LINEAR)
            levels.append((smaller, int(quotas[octave])))
        return levels

    def _detect_level(
        self, image: Bytes, octave: int, quota: int, full_shape: tuple[int, ...]
    ) -> Keypoints:
        xy, scores = self._fast.detect(image, quota)
        angle = _orientation(image, xy, self._disc)
        descriptor = self._describe(image, xy, angle)
        # Pixel centres lie at whole numbers: level pixel p covers full-resolution (p+½)s-½. Sizes
        # are whole, so s differs a little from a power of the factor, and between u and v.
        scale = np.array(full_shape[::-1]) / image.shape[::-1]
        full = ((xy + 0.5) * scale - 0.5).astype(np.float32)
        octaves = np.full(len(xy), octave, dtype=np.int32)
        return Keypoints(full, octaves, angle, scores, descriptor)

    def _describe(self, image: Bytes, xy: NDArray[np.int32], angle: Floats32) -> Bytes:
        if len(xy) == 0:
            return np.empty((0, 32), np.uint8)
        degrees = np.rad2deg(angle)
        keypoints = [
            cv2.KeyPoint(float(x), float(y), _PATCH, float(a))
            for (x, y), a in zip(xy.tolist(), degrees.tolist(), strict=True)
        ]
        kept, descriptor = self._describer.compute(image, keypoints)
        if len(kept) != len(xy):
            raise AssertionError(f"ORB described {len(kept)} of {len(xy)} keypoints")
        return np.asarray(descriptor, dtype=np.uint8)


def _disc_half_widths(radius: int) -> NDArray[np.int64]:
    rows = np.arange(radius + 1)
    return np.floor(np.sqrt(radius**2 - rows**2) + 0.5).astype(np.int64)


@numba.njit(cache=True, nogil=True)
def _orientation(image, xy, disc):  # type: ignore[no-untyped-def]
    """Angle from a corner to the centroid of grey in a disc around it (Rublee 2011, sec. 3.2)."""
    radius = len(disc) - 1
    angle = np.empty(len(xy), dtype=np.float32)
    for i in range(len(xy)):
        x0, y0 = xy[i, 0], xy[i, 1]
        m10 = np.int64(0)
        m01 = np.int64(0)
        for dy in range(-radius, radius + 1):
            half = disc[abs(dy)]
            row = image[y0 + dy]
            total = np.int64(0)
            for dx in range(-half, half + 1):
                grey = np.int64(row[x0 + dx])
                m10 += dx * grey
                total += grey
            m01 += dy * total
        angle[i] = np.arctan2(m01, m10)
    return angle
