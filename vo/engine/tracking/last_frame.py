"""The last tracked frame, as the next one needs it."""

from __future__ import annotations

from typing import NamedTuple

from vo.base.types import Bools, Floats, Ints
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.tracked_frame import TrackedFrame


class LastFrame(NamedTuple):
    """A tracked frame and the landmarks in it.

    Attributes:
        ids: (n,) increasing ids of the landmarks.
        image_xy: (n, 2) where they were found.
        inlier: (n,) whether they agreed with the pose.
    """

    frame: PreprocessedFrame
    ids: Ints
    image_xy: Floats
    inlier: Bools


def last_frame(frame: PreprocessedFrame, tracked: TrackedFrame) -> LastFrame:
    """What to keep of a tracked frame."""
    return LastFrame(frame, tracked.ids, tracked.observed.image_xy, tracked.inlier)
