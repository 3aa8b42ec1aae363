"""Markers that a run has seen, for recordings of it."""

from __future__ import annotations

from typing import NamedTuple

from vo.base.types import Floats


class MarkerOutline(NamedTuple):
    """A marker in a frame.

    Attributes:
        frame_index: number of the frame.
        corners: (4, 2) pixels of the left image of the view.
    """

    frame_index: int
    id: int
    corners: Floats


class MarkerSquare(NamedTuple):
    """A marker in a world.

    Attributes:
        segment: number of the world.
        corners: (4, 3) in the world of the path, in units of the map.
    """

    id: int
    segment: int
    first_frame: int
    corners: Floats


class SeenMarkers(NamedTuple):
    """Outlines in the order of frames, and the squares whose place is known."""

    outlines: tuple[MarkerOutline, ...]
    squares: tuple[MarkerSquare, ...]
