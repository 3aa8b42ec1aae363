"""Similarity of stored patches, one of them warped as the other keyframe should see it."""

from __future__ import annotations

import numpy as np

from vo.base.types import Bytes, Floats, Floats32
from vo.engine.places.records import PATCH_PX

COMPARED_PX = 9  # side of the compared part
_SHIFTS = (-1, 0, 1)  # a corner is detected to about a pixel of its level


def patch_correlation(earlier: Bytes, later: Bytes, earlier_from_later: Floats) -> Floats:
    """(N,) largest zero-mean normalised cross-correlation of patches over shifts of a pixel.

    Steps in the later patch map to the earlier one by `earlier_from_later` (N, 2, 2).
    """
    if len(earlier) == 0:
        return np.empty(0)
    first = (PATCH_PX - COMPARED_PX) // 2 - 1
    area = later[:, first : PATCH_PX - first, first : PATCH_PX - first].astype(np.float32)
    return largest_correlation(normalised(_warped(earlier, earlier_from_later)), area)


def largest_correlation(template: Floats32, area: Floats32) -> Floats:
    """(N,) largest correlation with a part of an area, over shifts of a pixel.

    Args:
        template: (N, COMPARED_PX ** 2) normalised.
        area: (N, COMPARED_PX + 2, COMPARED_PX + 2) grey levels.
    """
    best = np.full(len(area), -1.0)
    for dy in _SHIFTS:
        for dx in _SHIFTS:
            part = area[:, 1 + dy : 1 + dy + COMPARED_PX, 1 + dx : 1 + dx + COMPARED_PX]
            window = normalised(part.reshape(len(area), -1))
            best = np.maximum(best, (template * window).sum(axis=1))
    return best


def _warped(patches: Bytes, warp: Floats) -> Floats32:
    """(N, 81) grey levels of warped patches, bilinear, with their edges repeated."""
    across = np.arange(COMPARED_PX) - COMPARED_PX // 2
    steps = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2).astype(np.float64)
    at = np.clip(steps @ np.swapaxes(warp, 1, 2) + PATCH_PX // 2, 0.0, PATCH_PX - 1.001)
    whole = at.astype(np.int64)
    part = (at - whole).astype(np.float32)
    row, one = np.arange(len(patches))[:, None], np.float32(1.0)
    x, y, fx, fy = whole[..., 0], whole[..., 1], part[..., 0], part[..., 1]
    upper = patches[row, y, x] * (one - fx) + patches[row, y, x + 1] * fx
    lower = patches[row, y + 1, x] * (one - fx) + patches[row, y + 1, x + 1] * fx
    return np.asarray(upper * (one - fy) + lower * fy)


def normalised(values: Floats32) -> Floats32:
    """Rows with mean 0 and length 1; blank ones become 0."""
    centred = values - values.mean(axis=1, keepdims=True)
    length = np.linalg.norm(centred, axis=1, keepdims=True)
    return np.asarray(np.where(length > 1.0, centred / np.maximum(length, 1.0), 0.0))
