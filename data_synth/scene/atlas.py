"""Textures with their mip-maps, packed into one array for the compiled renderer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.types import Bytes, Floats32, Ints

LEVELS = 11


class Atlas(NamedTuple):
    """Mip-mapped textures; sides are powers of two, so that wrapping around is a bit mask."""

    texels: Bytes  # (T,) uint8, all levels of all textures row by row
    levels: Ints  # (N, LEVELS, 3) start, height and width of each level


def pack(textures: Sequence[Floats32]) -> Atlas:
    """Pack textures with LEVELS mip-maps each, every one the 2x2 mean of the one before."""
    parts: list[Bytes] = []
    levels = np.zeros((len(textures), LEVELS, 3), np.int64)
    total = 0
    for i, texture in enumerate(textures):
        level_image = texture
        for level in range(LEVELS):
            levels[i, level] = total, *level_image.shape
            parts.append(np.round(level_image * 255.0).astype(np.uint8).ravel())
            total += level_image.size
            level_image = _halved(level_image)
    return Atlas(np.concatenate(parts), levels)


def _halved(image: Floats32) -> Floats32:
    rows, columns = (2 if n > 1 else 1 for n in image.shape)
    shaped = image.reshape(image.shape[0] // rows, rows, image.shape[1] // columns, columns)
    return np.asarray(shaped.mean(axis=(1, 3)), dtype=np.float32)
