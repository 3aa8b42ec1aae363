"""Rectification in vector instructions, with the bits of `cv2.remap` in a quarter of its time.

Eight neighbours of a rectified image lie in 16 pixels of three rows of the recorded one, but for a
few: a shuffle of bytes takes them from there, for twice eight at once.
"""

from __future__ import annotations

from functools import reduce

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.base.compiling.function import Intrinsic, compiled
from vo.base.compiling.processor import has_common_instructions
from vo.base.geometry.rectification_maps import Maps
from vo.base.types import Bools, Bytes

Ints16 = NDArray[np.int16]

_blend = Intrinsic("vo.base.geometry.remap_intrinsics", "blend_sixteen")
_SIDE, _HALF = 16, 8  # pixels at once, and from the same three rows
_FROM = 16  # pixels of a row that they are taken from
_OPENCV_MAX = 2**15 - 1  # rows of its maps
_PREPARED_AFTER = 3  # images; preparing takes as long as is saved with three to five


class Remapping:
    """Interpolates in 8-bit grey images at the positions of maps."""

    def __init__(self, maps: Maps) -> None:
        self._maps = maps
        self._images = 0
        self._blocks: _Blocks | None = None

    def __call__(self, image: Bytes) -> Bytes:
        """The image at the positions of the maps, 0 outside."""
        self._images += 1
        if self._images == _PREPARED_AFTER and _is_usable(image, self._maps):
            blocks = _Blocks(self._maps, image.shape)
            self._blocks = blocks if len(blocks.rest) < _OPENCV_MAX else None
        if self._blocks is None or image.shape != self._blocks.shape:
            return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR), dtype=np.uint8)
        return self._blocks.blend(image)


class _Blocks:
    """Where the pixels of blocks of 16 are in images of one shape.

    Attributes:
        rest: pixels at positions inside of the image that are in no block.
    """

    def __init__(self, maps: Maps, shape: tuple[int, ...]) -> None:
        (height, width), (whole, self._part) = shape, maps
        rows, columns = self._part.shape
        blocks = columns // _SIDE
        # Pixel by pixel of all blocks: many axes of 16 or 2 elements are slow.
        pixels = [slice(k, k + blocks * _SIDE, _SIDE) for k in range(_SIDE)]
        u, v = np.ascontiguousarray(np.moveaxis(whole, 2, 0))
        is_block = np.ones((rows, blocks), dtype=bool)
        source = np.empty((rows, blocks, 2), np.int64)
        # Fractions, byte 0 to 14 from the first of a row times 2^10, and 2^14 in the second row.
        code = self._part.astype(np.int16)
        for half in range(2):
            of_half = pixels[half * _HALF : (half + 1) * _HALF]
            first_u, is_block_u = _begins(u, of_half, width, _FROM)
            first_v, is_block_v = _begins(v, of_half, height, 3)
            is_block &= is_block_u & is_block_v
            source[..., half] = first_v.astype(np.int64) * width + first_u
            for pixel in of_half:
                code[:, pixel] += (u[:, pixel] - first_u << 10) + (v[:, pixel] - first_v << 14)
        place = np.arange(rows)[:, None] * columns + _SIDE * np.arange(blocks)
        self.shape = shape
        self._code = code.reshape(-1)
        self._source, self._place = source[is_block], place[is_block]
        is_left = (u >= -1) & (u < width) & (v >= -1) & (v < height)
        for pixel in pixels:
            is_left[:, pixel] &= ~is_block
        self.rest = np.flatnonzero(is_left)
        is_all = _SIDE * len(self._place) + len(self.rest) == self._part.size
        self._new = np.empty if is_all else np.zeros  # pixels outside remain 0
        self._whole_of_rest = whole.reshape(-1, 1, 2)[self.rest]
        self._part_of_rest = self._part.reshape(-1, 1)[self.rest]

    def blend(self, image: Bytes) -> Bytes:
        """The image at the positions of the maps."""
        result: Bytes = self._new(self._part.shape, np.uint8)
        flat = result.reshape(-1)
        pixels, width = image.reshape(-1), image.shape[1]
        _blend_all(pixels, width, self._source, self._place, self._code, flat)
        if len(self.rest):
            maps = self._whole_of_rest, self._part_of_rest
            flat[self.rest] = cv2.remap(image, *maps, cv2.INTER_LINEAR)[:, 0]
        return result


def _begins(at: Ints16, pixels: list[slice], size: int, count: int) -> tuple[Ints16, Bools]:
    """First of `count` recorded pixels in a row or column, by block, and whether it lies in them.

    `at`: their numbers (H, W), of `size`.
    """
    least = reduce(np.minimum, [at[:, pixel] for pixel in pixels])
    last = reduce(np.maximum, [at[:, pixel] for pixel in pixels])
    first = np.minimum(least, np.int16(min(size - count, _OPENCV_MAX)))
    return first, (least >= 0) & (last < size - 1) & (last - first <= count - 2)


def _is_usable(image: Bytes, maps: Maps) -> bool:
    is_grey = image.ndim == 2 and image.dtype == np.uint8 and image.flags.carray
    is_large = is_grey and min(image.shape) >= _FROM and maps[1].shape[1] >= _SIDE
    return is_large and has_common_instructions()


@compiled
def _blend_all(pixels, width, source, place, code, result):  # type: ignore[no-untyped-def]
    """Fill each block, which begins at `place`, from three rows for either half."""
    for n in range(len(place)):
        _blend(pixels, source[n, 0], source[n, 1], width, place[n], code, result)
