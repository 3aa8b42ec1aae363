"""Association of left and right images, by stamp or by name, and offsets between their stamps."""

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
_MIN_IMAGES = 5
_MIN_PAIRED = 0.5  # ratio of images that are paired by their stamps: these are then right
_MIN_CONSTANT = 0.9  # ratio of images that must have a partner at the constant offset
_MAX_SPREAD = 0.1  # of the offsets, ratio of the interval; and at most the tolerance of a pair
# Maximum offset to the nearest image, ratio of the interval: of two images at half an interval
# neither is the partner.
_MAX_PHASE = 0.4


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
