"""Record of a focal length that changes during a recording."""

from __future__ import annotations

from typing import NamedTuple

MAX_SIGMA = 0.015
"""Of the logarithm of a focal length, above which a path is not to be trusted."""


class FocalLength(NamedTuple):
    """The focal length of cam0 at a time; between two times it changes evenly."""

    stamp_ns: int
    focal_px: float
    sigma_px: float


def focal_change(found: tuple[FocalLength, ...]) -> float:
    """The largest relative change since the first time, 0 if there is none."""
    changes = [each.focal_px / found[0].focal_px - 1.0 for each in found]
    return max(changes, key=abs, default=0.0)
