"""Frames between two tracked ones, whose poses are interpolated."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.transforms import interpolate
from vo.base.types import Floats, Ints


@frozen(eq=False)
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

    def rows(self, last: Any, frame_index: int) -> Iterator[tuple[Any, ...]]:
        """Rows of the frames between the last tracked one, a row, and the next one.

        None if tracked frames are missing between them.
        """
        first, begin, end = int(last["frame_index"]), last["stamp_ns"], self.stamps_ns[frame_index]
        if frame_index - first != self.stride * self.every:
            return
        for number in range(first + self.stride, frame_index, self.stride):
            stamp_ns = self.stamps_ns[number]
            fraction = (stamp_ns - begin) / (end - begin)
            yield number, stamp_ns, last["segment"], last["keyframe"], fraction, np.zeros((3, 4))


def fill(poses: Floats, fraction: Floats) -> None:
    """Interpolate (n, 4, 4) along the geodesic where the fraction is not 0, from tracked ones."""
    added = (fraction > 0).nonzero()[0].tolist()
    tracked = (fraction == 0).nonzero()[0] if added else fraction
    for row in added:
        after = int(np.searchsorted(tracked, row))
        first, last = poses[tracked[after - 1]], poses[tracked[after]]
        poses[row] = interpolate(first, last, float(fraction[row]))
