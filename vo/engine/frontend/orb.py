"""ORB features: FAST on a pyramid, spread by a grid, with orientation and rotated BRIEF."""

from __future__ import annotations

from concurrent.futures import Executor
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.compiling.signatures import usual_array
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
_GATHER_BITS = np.uint64(0x0102040810204080)

Weights = NDArray[np.int16]
_Level = tuple[NDArray[np.int32], Floats32, Floats32, Bytes]  # pixels of the level, scores, …


class OrbExtractor:
    """Detects and describes ORB features; holds only its settings.

    Source: Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011.
    """

    descriptor_format = DescriptorFormat(32, np.dtype(np.uint8))

    def __init__(self, config: FeaturesConfig) -> None:
        self._config = config
        self._fast = FastGrid(config.threshold, config.low_threshold, BORDER_PX)
        shares = config.scale_factor ** (-2.0 * np.arange(config.levels))
        self._quotas = np.round(config.count * shares / shares.sum()).astype(int).tolist()

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
        mask = None if mask is None else usual_array(mask)

        def detect_smaller() -> list[_Level]:
            return [self._detect_level(*level, mask) for level in smaller]

        others = None if helper is None else helper.submit(detect_smaller)
        largest = self._detect_level(*full, mask)
        levels = [largest, *(detect_smaller() if others is None else others.result())]
        xy, response, angle, descriptor = map(np.concatenate, zip(*levels, strict=True))
        octave = np.arange(len(levels), dtype=np.int32).repeat([len(level[0]) for level in levels])
        # Pixel centres lie at whole numbers: level pixel p covers full-resolution (p+½)s-½. Sizes
        # are whole, so s differs a little from a power of the factor, and between u and v.
        sizes = np.array([image.shape[::-1] for image, _ in (full, *smaller)])
        scale = (sizes[0] / sizes)[octave]
        full_xy = ((xy + 0.5) * scale - 0.5).astype(np.float32)
        keypoints = Keypoints(full_xy, octave, angle, response, descriptor)
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
        factor, quotas = self._config.scale_factor, self._quotas
        levels = [(np.ascontiguousarray(image), quotas[0])]
        height, width = image.shape
        for octave in range(1, self._config.levels):
            size = (round(width / factor**octave), round(height / factor**octave))
            if min(size) <= 2 * BORDER_PX + 1:
                break
            smaller = cv2.resize(levels[-1][0], size, interpolation=cv2.INTER_LINEAR)
            levels.append((smaller, quotas[octave]))
        return levels

    def _detect_level(self, image: Bytes, quota: int, mask: Bytes | None) -> _Level:
        if mask is not None and mask.shape != image.shape:
            size = image.shape[::-1]
            mask = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        xy, scores = self._fast.detect(image, quota, mask)
        return xy, scores, *describe_corners(image, xy)


def describe_corners(image: Bytes, xy: NDArray[np.int32]) -> tuple[Floats32, Bytes]:
    """Orientations (N,) and rotated BRIEF (N, 32) of pixels at least `BORDER_PX` from the edges."""
    blur, *tables = _tables()
    blurred = cv2.sepFilter2D(image, -1, blur, blur)
    angle, descriptor = _described(image, blurred, xy, *tables)
    return angle, descriptor


@lru_cache(maxsize=1)
def _tables() -> tuple[Floats, Weights, Weights, Floats32]:
    """Weights of the blur and of the moments, and the pattern of compared pixels."""
    pattern = np.array(_PAIRS, dtype=np.float32).reshape(-1, 2, 2).transpose(2, 1, 0)
    compared = np.ascontiguousarray(pattern.reshape(2, -1))
    return cv2.getGaussianKernel(_BLUR_PX, _BLUR_SIGMA_PX), *_moment_weights(), compared


def _outside_mask(keypoints: Keypoints, mask: Bytes) -> Keypoints:
    """The keypoints at whose nearest pixel the mask is not 0."""
    return keypoints.select(used_at(mask, keypoints.xy))


def _moment_weights() -> tuple[Weights, Weights]:
    """Weights of the intensity-centroid moments: x and y in the lower half of a disc, 0 beside it.

    By rows, from the middle one on.
    """
    y, x = np.mgrid[: _RADIUS + 1, -_RADIUS : _SIDE - _RADIUS]
    inside = np.abs(x) <= np.floor(np.sqrt(_RADIUS**2 - y**2) + 0.5)
    return (x * inside).astype(np.int16), (y * inside).astype(np.int16)


@compiled
def _described(image, blurred, xy, x_weights, y_weights, pattern):  # type: ignore[no-untyped-def]
    """Orientations and descriptors."""
    angle = np.empty(len(xy), dtype=np.float32)
    for i in range(len(xy)):
        angle[i] = _orientation(image, xy[i, 0], xy[i, 1], x_weights, y_weights)
    return angle, _describe(blurred, xy, angle, pattern)


@compiled(**NO_REFCOUNT)
def _orientation(image, x, y, x_weights, y_weights):  # type: ignore[no-untyped-def]
    """Angle from a corner to the centroid of grey in a disc around it (Rublee 2011, sec. 3.2).

    Rows at the same distance above and below have the same weights of x and opposite ones of y.
    """
    left, x_moment, y_moment = x - _RADIUS, np.int32(0), np.int32(0)
    for dx in range(_SIDE):
        x_moment = np.int32(x_moment + np.int32(image[y, left + dx]) * np.int32(x_weights[0, dx]))
    for dy in range(1, len(x_weights)):
        above, below = image[y - dy, left : left + _SIDE], image[y + dy, left : left + _SIDE]
        for dx in range(_SIDE):
            a, b = np.int32(above[dx]), np.int32(below[dx])
            x_moment = np.int32(x_moment + np.int32(b + a) * np.int32(x_weights[dy, dx]))
            y_moment = np.int32(y_moment + np.int32(b - a) * np.int32(y_weights[dy, dx]))
    return np.arctan2(np.float64(y_moment), np.float64(x_moment))


@compiled
def _describe(blurred, xy, angle, pattern):  # type: ignore[no-untyped-def]
    """Rotated BRIEF (Rublee 2011, sec. 4): (N, 32) bytes of bits, each a pixel below another."""
    pixels, stride, bits = blurred.ravel(), blurred.shape[1], pattern.shape[1] // 2
    descriptor = np.empty((len(xy), bits // 8), dtype=np.uint8)
    place = np.empty(2 * bits, dtype=np.int32)
    first, second = np.empty((2, bits), dtype=np.uint8)
    is_below = np.empty(bits, dtype=np.uint8)
    eights = is_below.view(np.uint64)
    for i in range(len(xy)):
        c, s = np.cos(angle[i]), np.sin(angle[i])
        start = xy[i, 1] * stride + xy[i, 0]
        for k in range(len(place)):
            x, y = pattern[0, k], pattern[1, k]
            column, row = np.int32(np.rint(x * c - y * s)), np.int32(np.rint(x * s + y * c))
            place[k] = start + row * stride + column
        for k in range(bits):
            first[k] = pixels[np.uint32(place[k])]
            second[k] = pixels[np.uint32(place[bits + k])]
        for k in range(bits):
            is_below[k] = first[k] < second[k]
        for byte in range(len(eights)):  # the product has the lowest bits of eight bytes in its top
            descriptor[i, byte] = (eights[byte] * _GATHER_BITS) >> np.uint64(56)
    return descriptor
