"""Stamps in the names of image files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from vo.recordings.formats.stamp_units import MAX_STAMP_NS, stamp_ns_from_seconds
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot, check_increasing, median_interval_ns

_NS_PER_UNIT = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
_MIN_INTERVAL_NS = 2_000_000
_MAX_INTERVAL_NS = 20_000_000_000
_MIN_STAMP = 1_000_000_000  # smaller integers are counters, not times


def shots_from_names(images: Sequence[Path]) -> list[Shot] | None:
    """Read stamps from file names that end in a time; None if they do not.

    Numbers with a decimal point are seconds. Integers from 10^9 are nanoseconds, microseconds,
    milliseconds or seconds: the first unit with a median interval from 2 ms to 20 s.
    """
    numbers = [_last_number(path) for path in images]
    if len(images) < 2 or not all(numbers):
        return None
    stamps_ns = _stamps_of_numbers(numbers)
    if stamps_ns is None or max(stamps_ns) > MAX_STAMP_NS:
        return None
    shots = [Shot(s, ImageFile(p), f"file {p}") for s, p in zip(stamps_ns, images, strict=True)]
    shots.sort(key=lambda shot: shot.stamp_ns)
    check_increasing(shots)
    return shots


def _last_number(path: Path) -> str:
    found = re.search(r"\d+(\.\d+)?$", path.stem)
    return found.group() if found else ""


def _stamps_of_numbers(numbers: Sequence[str]) -> list[int] | None:
    if any("." in number for number in numbers):
        units = ["s"]
    elif min(int(number) for number in numbers) >= _MIN_STAMP:
        units = list(_NS_PER_UNIT)
    else:
        return None
    for unit in units:
        if unit == "s":
            stamps = [stamp_ns_from_seconds(number) for number in numbers]
        else:
            stamps = [int(number) * _NS_PER_UNIT[unit] for number in numbers]
        if _MIN_INTERVAL_NS <= median_interval_ns(stamps) <= _MAX_INTERVAL_NS:
            return stamps
    return None
