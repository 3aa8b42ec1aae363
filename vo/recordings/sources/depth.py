"""Depth images: association with the images of cam0, and conversion to metres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats32
from vo.recordings.sources.images import StoredImage
from vo.recordings.sources.listing import Shot

UNITS_PER_METRE = 5000.0
"""Scale of the 16-bit depth images of TUM RGB-D, unless the calibration contains another."""

_TOLERANCE_NS = 20_000_000


class DepthImages(NamedTuple):
    """The depth image of each image of cam0, and the number of pixel units per metre."""

    images: Sequence[StoredImage | None]
    per_metre: float


def read_depth(stored: StoredImage, per_metre: float) -> Floats32:
    """Depth (H, W) in metres, 0 where unknown."""
    return np.asarray(stored.read() / np.float32(per_metre), dtype=np.float32)


def associate_depth(left: Sequence[Shot], depth: Sequence[Shot]) -> list[StoredImage | None]:
    """The depth image of each left image, at most 20 ms away in time; each is used once.

    Candidate pairs are accepted in order of increasing time difference.

    Source: `associate.py` of the TUM RGB-D benchmark tools.
    """
    stamps = np.array([shot.stamp_ns for shot in depth], dtype=np.int64)
    candidates = []
    for i, shot in enumerate(left):
        first = int(np.searchsorted(stamps, shot.stamp_ns - _TOLERANCE_NS, side="right"))
        last = int(np.searchsorted(stamps, shot.stamp_ns + _TOLERANCE_NS))
        candidates += [(abs(int(stamps[j]) - shot.stamp_ns), i, j) for j in range(first, last)]
    found: list[StoredImage | None] = [None] * len(left)
    used = np.zeros(len(depth), dtype=bool)
    for _, i, j in sorted(candidates):
        if found[i] is None and not used[j]:
            found[i] = depth[j].image
            used[j] = True
    return found
