"""ORB features: FAST on a pyramid, spread by a grid, with orientation and rotated BRIEF."""

from __future__ import annotations

from concurrent.futures import Executor
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import compiled
from vo.base.config import FeaturesConfig
from vo.base.types import Bytes, Floats, Floats32, Keypoints
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.frontend.fast import FastGrid
from vo.engine.geometry.image_masks import used_at

_RADIUS = 15  # of the described patch, in pixels of its pyramid level
BORDER_PX = 19  # room for the rotated patch and its blur
_SIDE = 2 * _RADIUS + 2  # of the square around a corner that is summed up; even, for vector units
_BLUR_PX = 7  # side of the filter before pixels are compared, and its standard deviation
_BLUR_SIGMA_PX = 2.0
# x, y of the two pixels that each of the 256 bits compares, learned by the authors of ORB (sec.
# 4.3), in the order of OpenCV: descriptors are the same there.
_PAIRS = (Path(__file__).parent / "orb_pattern.txt").read_text("ascii").split()


class OrbExtractor:
    """Detects and describes ORB features; holds only its settings.

    Source: Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011.
    """

    descriptor_format = DescriptorFormat(32, np.dtype(np.uint8))

    def __init__(self, config: FeaturesConfig) -> None:
        self._config = config
        self._fast = FastGrid(config.threshold, config.low_threshold, BORDER_PX)

    @property
    def scale_factor(self) -> float:
        """Size ratio of two pyramid levels."""
        return self._config.scale_factor

    def extract(
        self, image: Bytes, mask: Bytes | None = None, helper: Executor | None = None
    ) -> Keypoints:
        """Features of an (H, W) uint8 image, by pyramid level, then in scan order.

        Args:
            image: (H, W) uint8.
            mask: (H, W) uint8, 0 where no feature may lie; None for the whole image.
            helper: extracts from the smaller levels, half of the work, at the same time.
        """
        full, *smaller = self._pyramid(image)

        def detect_smaller() -> list[Keypoints]:
            return [self._detect_level(*s, o, image.shape, mask) for o, s in enumerate(smaller, 1)]

        others = None if helper is None else helper.submit(detect_smaller)
        largest = self._detect_level(*full, 0, image.shape, mask)
        levels = [largest, *(detect_smaller() if others is None else others.result())]
        keypoints = Keypoints(
            xy=np.concatenate([k.xy for k in levels]),
            octave=np.concatenate([k.octave for k in levels]),
            angle=np.concatenate([k.angle for k in levels]),
            response=np.concatenate([k.response for k in levels]),
            descriptor=np.concatenate([k.descriptor for k in levels]),
        )
        return keypoints if mask is None else _outside_mask(keypoints, mask)

    def extract_and_describe(
        self, image: Bytes, xy: Floats, mask: Bytes | None = None
    ) -> tuple[Keypoints, Keypoints]:
        """Features of an image, and given pixels (N, 2) of it as features of its largest level."""
        size = np.array(image.shape[::-1])
        framed = cv2.copyMakeBorder(image, *(BORDER_PX,) * 4, cv2.BORDER_REFLECT_101)
        at = np.rint(xy).clip(0, size - 1).astype(np.int32) + BORDER_PX
        angle, descriptor = describe_corners(np.asarray(framed, np.uint8), at)
        count = len(xy)
        given = Keypoints(
            xy.astype(np.float32),
            np.zeros(count, np.int32),
            angle,
            np.zeros(count, np.float32),
            descriptor,
        )
        return self.extract(image, mask), given

    def _pyramid(self, image: Bytes) -> list[tuple[Bytes, int]]:
        factor = self._config.scale_factor
        shares = factor ** (-2.0 * np.arange(self._config.levels))
        quotas = np.round(self._config.count * shares / shares.sum()).astype(int)
        levels = [(np.ascontiguousarray(image), int(quotas[0]))]
        height, width = image.shape
        for octave in range(1, self._config.levels):
            size = (round(width / factor**octave), round(height / factor**octave))
            if min(size) <= 2 * BORDER_PX + 1:
                break
            smaller = cv2.resize(levels[-1][0], size, interpolation=cv2.INTER_LINEAR)
            levels.append((smaller, int(quotas[octave])))
        return levels

    def _detect_level(
        self,
        image: Bytes,
        quota: int,
        octave: int,
        full_shape: tuple[int, ...],
        mask: Bytes | None,
    ) -> Keypoints:
        if mask is not None and octave:
            size = image.shape[::-1]
            mask = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        xy, scores = self._fast.detect(image, quota, mask)
        angle, descriptor = describe_corners(image, xy)
        # Pixel centres lie at whole numbers: level pixel p covers full-resolution (p+½)s-½. Sizes
        # are whole, so s differs a little from a power of the factor, and between u and v.
        scale = np.array(full_shape[::-1]) / image.shape[::-1]
        full = ((xy + 0.5) * scale - 0.5).astype(np.float32)
        octaves = np.full(len(xy), octave, dtype=np.int32)
        return Keypoints(full, octaves, angle, scores, descriptor)


def describe_corners(image: Bytes, xy: NDArray[np.int32]) -> tuple[Floats32, Bytes]:
    """Orientations (N,) and rotated BRIEF (N, 32) of pixels at least `BORDER_PX` from the edges."""
    blur, moments, pattern = _tables()
    angle = _orientation(image, xy, *moments)
    blurred = cv2.sepFilter2D(image, -1, blur, blur)
    return angle, _describe(blurred, xy, angle, pattern)


@lru_cache(maxsize=1)
def _tables() -> tuple[Floats, tuple[Floats32, Floats32], Floats32]:
    """Weights of the blur and of the moments, and the pattern of compared pixels."""
    pattern = np.array(_PAIRS, dtype=np.float32).reshape(-1, 2).T.copy()
    return cv2.getGaussianKernel(_BLUR_PX, _BLUR_SIGMA_PX), _moment_weights(), pattern


def _outside_mask(keypoints: Keypoints, mask: Bytes) -> Keypoints:
    """The keypoints at whose nearest pixel the mask is not 0."""
    return keypoints.select(used_at(mask, keypoints.xy))


def _moment_weights() -> tuple[Floats32, Floats32]:
    """Weights of the intensity-centroid moments: pixels of a square, 0 outside of its disc."""
    y, x = np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _SIDE - _RADIUS].astype(np.float32)
    half_width = np.floor(np.sqrt(_RADIUS**2 - y**2) + 0.5)
    inside = np.abs(x) <= half_width
    return x * inside, y * inside


@compiled
def _orientation(image, xy, x_weights, y_weights):  # type: ignore[no-untyped-def]
    """Angle from a corner to the centroid of grey in a disc around it (Rublee 2011, sec. 3.2)."""
    angle = np.empty(len(xy), dtype=np.float32)
    # By column; of whole numbers below 2^24, so exact.
    x_moments, y_moments = np.empty((2, _SIDE), dtype=np.float32)
    for i in range(len(xy)):
        left, top = xy[i, 0] - _RADIUS, xy[i, 1] - _RADIUS
        x_moments[:] = 0.0
        y_moments[:] = 0.0
        for dy in range(len(x_weights)):
            row = image[top + dy, left : left + _SIDE]
            for dx in range(_SIDE):
                grey = np.float32(row[dx])
                x_moments[dx] += grey * x_weights[dy, dx]
                y_moments[dx] += grey * y_weights[dy, dx]
        angle[i] = np.arctan2(np.float64(y_moments.sum()), np.float64(x_moments.sum()))
    return angle


@compiled
def _describe(blurred, xy, angle, pattern):  # type: ignore[no-untyped-def]
    """Rotated BRIEF (Rublee 2011, sec. 4): (N, 32) bytes of bits, each a pixel below another."""
    pixels, stride = blurred.ravel(), blurred.shape[1]
    descriptor = np.empty((len(xy), 32), dtype=np.uint8)
    place = np.empty(pattern.shape[1], dtype=np.int32)
    for i in range(len(xy)):
        c, s = np.cos(angle[i]), np.sin(angle[i])
        start = xy[i, 1] * stride + xy[i, 0]
        for k in range(len(place)):
            x, y = pattern[0, k], pattern[1, k]
            column, row = np.int32(np.rint(x * c - y * s)), np.int32(np.rint(x * s + y * c))
            place[k] = start + row * stride + column
        for byte in range(32):
            bits = 0
            for bit in range(8):
                pair = 16 * byte + 2 * bit
                bits |= (pixels[place[pair]] < pixels[place[pair + 1]]) << bit
            descriptor[i, byte] = bits
    return descriptor
