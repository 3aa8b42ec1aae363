"""Masks (H, W) of images: 0 where an image is not used."""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools, Bytes, Floats, Floats32


def used_at(mask: Bytes, xy: Floats | Floats32) -> Bools:
    """(N,) whether the pixels nearest to positions (N, 2), which are finite, are used."""
    u, v = np.rint(xy).astype(np.int64).T
    height, width = mask.shape
    return np.asarray(mask[v.clip(0, height - 1), u.clip(0, width - 1)] > 0)
