"""Frames kept until it is known whether content that is fixed in the image misled their tracking.

Such content is found after the scene has moved several times. Until then it may have held the
camera's path in its place, so the frames are tracked once more, without it.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from vo.base.faults import Fault
from vo.base.types import Frame
from vo.engine.frontend.image_fixed import ImageFixed
from vo.engine.frontend.image_repetition import Repetition

_MAX_BYTES = 64_000_000  # of their images


class RecordedFrame(NamedTuple):
    """A frame as recorded, and what its images were found to be.

    Attributes:
        repetition: whether the image of camera 0 repeats the one before.
    """

    frame: Frame
    repetition: Repetition
    faults: tuple[Fault, ...]


class RecentFrames:
    """The newest frames, as many as fit into 64 MB, until nothing is expected to be found."""

    def __init__(self) -> None:
        self._frames: deque[RecordedFrame] = deque()
        self._finds = 0

    def add(self, recorded: RecordedFrame, fixed: ImageFixed) -> list[RecordedFrame]:
        """Add a frame, and what is known to be fixed in its image.

        Returns:
            The frames before it, in time order, if something new was found; else none.
        """
        is_new = fixed.finds > self._finds
        self._finds = fixed.finds
        if is_new:
            misled = list(self._frames)
            self._frames.clear()
            return misled
        if fixed.mask is not None or fixed.is_settled:
            self._frames.clear()
            return []
        self._frames.append(recorded)
        size = sum(image.nbytes for image in recorded.frame.images if image is not None)
        while len(self._frames) * size > _MAX_BYTES:
            self._frames.popleft()
        return []
