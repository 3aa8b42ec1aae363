"""Similarity of stored patches, one of them warped as the other keyframe should see it."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bytes, Floats, Floats32
from vo.engine.places.records import PATCH_PX

COMPARED_PX = 9  # side of the compared part
_BLANK = 1.0  # length of grey levels without their mean


def patch_correlation(earlier: Bytes, later: Bytes, earlier_from_later: Floats) -> Floats:
    """(N,) largest zero-mean normalised cross-correlation of patches over shifts of a pixel.

    Steps in the later patch map to the earlier one by `earlier_from_later` (N, 2, 2).
    """
    first = (PATCH_PX - COMPARED_PX) // 2 - 1
    area = later[:, first : PATCH_PX - first, first : PATCH_PX - first].astype(np.float32)
    template = np.empty((len(earlier), COMPARED_PX, COMPARED_PX), np.float32)
    _warp(np.ascontiguousarray(earlier), np.ascontiguousarray(earlier_from_later), template)
    return largest_correlation(template, area)


def largest_correlation(template: Floats32, area: Floats32) -> Floats:
    """(N,) largest correlation with a part of an area, over shifts of a pixel; 0 if one is blank.

    A corner is detected to about a pixel of its level.

    Args:
        template: (N, COMPARED_PX, COMPARED_PX) grey levels.
        area: (N, COMPARED_PX + 2, COMPARED_PX + 2) grey levels.
    """
    best = np.full(len(area), -1.0)
    _correlate(np.ascontiguousarray(template), np.ascontiguousarray(area), best)
    return best


@compiled
def _correlate(template, area, best):  # type: ignore[no-untyped-def]
    """Raise each of `best` (N,) to the largest correlation."""
    side = template.shape[1]
    count = side * side
    for n in range(len(template)):
        total = total_squared = 0.0
        for y in range(side):
            for x in range(side):
                total += template[n, y, x]
                total_squared += float(template[n, y, x]) * template[n, y, x]
        mean = total / count
        length = np.sqrt(max(total_squared - total * mean, 0.0))
        for dy in range(area.shape[1] - side + 1):
            for dx in range(area.shape[2] - side + 1):
                level = squared = product = 0.0
                for y in range(side):
                    for x in range(side):
                        grey = float(area[n, dy + y, dx + x])
                        level += grey
                        squared += grey * grey
                        product += grey * (template[n, y, x] - mean)
                spread = np.sqrt(max(squared - level * level / count, 0.0))
                if length > _BLANK and spread > _BLANK:
                    best[n] = max(best[n], product / (length * spread))
                else:
                    best[n] = max(best[n], 0.0)


@compiled
def _warp(patches, warp, warped):  # type: ignore[no-untyped-def]
    """Grey levels (N, side, side) of warped patches, bilinear, with their edges repeated."""
    side, last, middle = warped.shape[1], patches.shape[1] - 1.001, patches.shape[1] // 2
    for n in range(len(patches)):
        for row in range(side):
            for column in range(side):
                dx, dy = column - side // 2, row - side // 2
                u = min(max(warp[n, 0, 0] * dx + warp[n, 0, 1] * dy + middle, 0.0), last)
                v = min(max(warp[n, 1, 0] * dx + warp[n, 1, 1] * dy + middle, 0.0), last)
                x, y = int(u), int(v)
                fx, fy = u - x, v - y
                upper = patches[n, y, x] * (1.0 - fx) + patches[n, y, x + 1] * fx
                lower = patches[n, y + 1, x] * (1.0 - fx) + patches[n, y + 1, x + 1] * fx
                warped[n, row, column] = upper * (1.0 - fy) + lower * fy
