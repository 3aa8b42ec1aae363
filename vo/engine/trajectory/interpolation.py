"""Frames between two tracked ones, whose poses are interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.geometry.transforms import interpolate
from vo.base.types import Floats, Ints


@dataclass(frozen=True, eq=False)
class InterpolatedFrames:
    """Frames that are not tracked but interpolated between tracked ones.

    Attributes:
        stamps_ns: (N,) of all frames of the recording.
        stride: step between requested frames.
        every: every so many requested frames one is tracked.
    """

    stamps_ns: Ints
    stride: int
    every: int

    def between(self, first: int, last: int) -> range:
        """Frames between two tracked ones; none if tracked frames are missing between them."""
        if last - first != self.stride * self.every:
            return range(0)
        return range(first + self.stride, last, self.stride)


def fill(poses: Floats, fraction: Floats) -> None:
    """Interpolate (n, 4, 4) along the geodesic where the fraction is not 0, from tracked ones."""
    tracked = np.flatnonzero(fraction == 0)
    for row in np.flatnonzero(fraction > 0).tolist():
        after = int(np.searchsorted(tracked, row))
        first, last = poses[tracked[after - 1]], poses[tracked[after]]
        poses[row] = interpolate(first, last, float(fraction[row]))
