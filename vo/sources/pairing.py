"""Finds the right image of each left one, by stamp or by name."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vo.errors import SourceError
from vo.sources.images import ImageFile, StoredImage
from vo.sources.listing import Shot, median_interval_ns
from vo.types import Ints

_log = logging.getLogger(__name__)

LARGEST_TOLERANCE_NS = 5_000_000
"""A car at 30 m/s moves 15 cm in 5 ms; images further apart in time are no stereo pair."""


def pair_by_stamp(left: Sequence[Shot], right: Sequence[Shot]) -> list[StoredImage | None]:
    """The right partner of each left image, or None where there is none.

    Two images are partners if each is the other's nearest in time and they are no further apart
    than half the median interval between left images, and 5 ms. Right images without a partner are
    warned of and dropped.

    Args:
        left: N images, stamps increasing.
        right: M images, stamps increasing.

    Returns:
        N images or None.
    """
    stamps_left = np.array([shot.stamp_ns for shot in left], dtype=np.int64)
    stamps_right = np.array([shot.stamp_ns for shot in right], dtype=np.int64)
    of_left = _nearest(stamps_left, stamps_right)
    of_right = _nearest(stamps_right, stamps_left)
    mutual = of_right[of_left] == np.arange(len(left))
    close = np.abs(stamps_right[of_left] - stamps_left) <= tolerance_ns(stamps_left)
    partners = [
        right[j].image if ok else None for j, ok in zip(of_left, mutual & close, strict=True)
    ]
    _warn_of_dropped(len(right) - sum(p is not None for p in partners), len(right))
    return partners


def tolerance_ns(stamps_left: Ints) -> int:
    """How far apart in time two images may be and still be a pair, in nanoseconds."""
    interval = median_interval_ns(stamps_left.tolist())
    return min(interval // 2, LARGEST_TOLERANCE_NS) if interval else LARGEST_TOLERANCE_NS


def stamped_like(left: Sequence[Shot], right: Sequence[Path]) -> list[Shot]:
    """Give right images, that have no stamps of their own, those of the left images.

    Images of the same name (without suffix) belong together; if no name occurs on both sides, the
    order tells, if there are as many.

    Raises:
        SourceError: neither names nor counts agree.
    """
    by_name = {Path(shot.image.name).stem: shot for shot in left}
    shots = [
        Shot(by_name[path.stem].stamp_ns, ImageFile(path), by_name[path.stem].place)
        for path in right
        if path.stem in by_name
    ]
    if not shots:
        if len(left) != len(right):
            folder = Path(left[0].image.name).parent
            raise SourceError(
                f"{folder} has {len(left)} images and {right[0].parent} has "
                f"{len(right)}, with no name in common; name the images of a pair alike"
            )
        return [
            Shot(a.stamp_ns, ImageFile(path), a.place) for a, path in zip(left, right, strict=True)
        ]
    _warn_of_dropped(len(right) - len(shots), len(right))
    return sorted(shots, key=lambda shot: shot.stamp_ns)


def _nearest(stamps: Ints, others: Ints) -> Ints:
    """For each stamp (N,) the index of the nearest other (M,), the earlier of two as near."""
    after = np.clip(np.searchsorted(others, stamps), 1, max(len(others) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(others) - 1)
    is_after = np.abs(others[after] - stamps) < np.abs(others[before] - stamps)
    return np.asarray(np.where(is_after, after, before), dtype=np.int64)


def _warn_of_dropped(dropped: int, total: int) -> None:
    if dropped:
        _log.warning("%d of %d right images have no left partner and are not used", dropped, total)
