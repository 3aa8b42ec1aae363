"""Offset between the stamps of left and right images that are taken at the same time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vo.base.types import Ints
from vo.recordings.sources.listing import Shot, median_interval_ns
from vo.recordings.sources.pairing import nearest, tolerance_ns

_MIN_IMAGES = 5
_MIN_PAIRED = 0.5  # ratio of images that are paired by their stamps: these are then right
_MIN_CONSTANT = 0.9  # ratio of images that must have a partner at the constant offset
_MAX_SPREAD = 0.1  # of the offsets, ratio of the interval; and at most the tolerance of a pair
# Maximum offset to the nearest image, ratio of the interval: of two images at half an interval
# neither is the partner.
_MAX_PHASE = 0.4


def shifted(shots: Sequence[Shot], offset_ns: int) -> list[Shot]:
    """Images with `offset_ns` added to their stamps."""
    return [shot._replace(stamp_ns=shot.stamp_ns + offset_ns) for shot in shots]


def constant_offset_ns(left: Sequence[Shot], right: Sequence[Shot]) -> int:
    """What to add to the stamps of right images so that pairs get the same stamps; mostly 0.

    Clocks that were not set, and cameras that count from their own start, give all right stamps the
    same offset. It is 0 if at least half of the images have a partner by their stamps as they are.
    Otherwise the images of the same number are compared, if there are as many on both sides, for an
    offset of at least an interval, or else the nearest ones, for one of at most 0.4 intervals. The
    offset must be constant over the whole recording.
    """
    stamps, others = (np.array([s.stamp_ns for s in side], np.int64) for side in (left, right))
    if min(len(stamps), len(others)) < _MIN_IMAGES:
        return 0
    fewest, tolerance = min(len(stamps), len(others)), tolerance_ns(stamps)
    nearest_ns = _mutual_offsets(stamps, others)
    if np.count_nonzero(np.abs(nearest_ns) <= tolerance) >= _MIN_PAIRED * fewest:
        return 0
    interval = median_interval_ns(stamps.tolist())
    spread = min(_MAX_SPREAD * interval, tolerance)
    if len(stamps) == len(others) and _is_constant(others - stamps, fewest, spread):
        offset = int(np.median(others - stamps))
        if abs(offset) >= interval:  # of clocks; a shorter one may be that of alternating cameras
            return -offset
    phase = int(np.median(nearest_ns)) if len(nearest_ns) else 0
    is_near = abs(phase) <= _MAX_PHASE * interval
    return -phase if is_near and _is_constant(nearest_ns, fewest, spread) else 0


def _mutual_offsets(left: Ints, right: Ints) -> Ints:
    """Right minus left stamp of images that are nearest to each other."""
    of_left, of_right = nearest(left, right), nearest(right, left)
    mutual = of_right[of_left] == np.arange(len(left))
    return np.asarray((right[of_left] - left)[mutual], dtype=np.int64)


def _is_constant(offsets_ns: Ints, fewest: int, spread_ns: float) -> bool:
    if len(offsets_ns) < _MIN_CONSTANT * fewest:
        return False
    differences = np.abs(offsets_ns - np.median(offsets_ns))
    return bool(np.mean(differences <= 0.5 * spread_ns) >= _MIN_CONSTANT)
