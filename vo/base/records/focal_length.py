"""Record of a focal length that changes during a recording."""

from __future__ import annotations

from typing import NamedTuple


class FocalLength(NamedTuple):
    """The focal length of cam0 at a time; between two times it changes evenly."""

    stamp_ns: int
    focal_px: float
    sigma_px: float
