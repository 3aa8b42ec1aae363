"""Association of left and right images, by stamp or by name."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.types import Ints
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.images import ImageFile, StoredImage
from vo.recordings.sources.listing import Shot, median_interval_ns

_log = logging.getLogger(__name__)

MAX_TOLERANCE_NS = 5_000_000
"""Maximum time difference of a stereo pair; a car at 30 m/s moves 15 cm in 5 ms."""


def pair_by_stamp(left: Sequence[Shot], right: Sequence[Shot]) -> list[StoredImage | None]:
    """The right image of each left image, None where there is none.

    Two images form a pair if they are mutual nearest neighbours in time and differ by at most half
    the median interval of the left images, and at most 5 ms. Unpaired right images are dropped,
    with a warning.
    """
    stamps_left = np.array([shot.stamp_ns for shot in left], dtype=np.int64)
    stamps_right = np.array([shot.stamp_ns for shot in right], dtype=np.int64)
    of_left = nearest(stamps_left, stamps_right)
    of_right = nearest(stamps_right, stamps_left)
    mutual = of_right[of_left] == np.arange(len(left))
    close = np.abs(stamps_right[of_left] - stamps_left) <= tolerance_ns(stamps_left)
    partners = [
        right[j].image if ok else None for j, ok in zip(of_left, mutual & close, strict=True)
    ]
    _warn_of_unpaired(len(right) - sum(p is not None for p in partners), len(right))
    return partners


def tolerance_ns(stamps_left: Ints) -> int:
    """Maximum time difference of a pair, in nanoseconds."""
    interval = median_interval_ns(stamps_left.tolist())
    return min(interval // 2, MAX_TOLERANCE_NS) if interval else MAX_TOLERANCE_NS


def copy_stamps(left: Sequence[Shot], right: Sequence[Path]) -> list[Shot]:
    """Assign the stamps of the left images to right images without stamps.

    Images are paired by name (without suffix), or by order if no name occurs on both sides and
    both have the same number of images.
    """
    by_name = {Path(shot.image.name).stem: shot for shot in left}
    shots = [
        Shot(by_name[path.stem].stamp_ns, ImageFile(path), by_name[path.stem].location)
        for path in right
        if path.stem in by_name
    ]
    if not shots:
        if len(left) != len(right):
            folder = Path(left[0].image.name).parent
            raise SourceError(
                f"{folder} has {len(left)} images and {right[0].parent} has "
                f"{len(right)}, with no name in common; give the images of a pair the same name"
            )
        return [
            Shot(shot.stamp_ns, ImageFile(path), shot.location)
            for shot, path in zip(left, right, strict=True)
        ]
    _warn_of_unpaired(len(right) - len(shots), len(right))
    return sorted(shots, key=lambda shot: shot.stamp_ns)


def nearest(stamps: Ints, others: Ints) -> Ints:
    """Index of the nearest of `others` (M,) for each stamp (N,); the earlier one of a tie."""
    after = np.clip(np.searchsorted(others, stamps), 1, max(len(others) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(others) - 1)
    is_after = np.abs(others[after] - stamps) < np.abs(others[before] - stamps)
    return np.asarray(np.where(is_after, after, before), dtype=np.int64)


def _warn_of_unpaired(unpaired: int, total: int) -> None:
    if unpaired:
        _log.warning(
            "%d of %d right images have no left image and are not used",
            unpaired,
            total,
            extra=warning_kind("unpaired_images"),
        )
