"""When the pose graph is optimised, and when its result is applied."""

from __future__ import annotations

import math

# A result is applied after so many further keyframes; the number is fixed, so that the path does
# not depend on the speed of the optimizer.
_LATENCY = 3
_FRAME_LATENCY = 5  # ... or so many frames, while the camera is in a segment of its own
_SPACING = 10  # minimum of keyframes from one graph to the next
_SPACING_RATIO = 0.05  # of all keyframes, if that is more: large graphs take longer


class GraphSchedule:
    """Counts keyframes and frames, and tells when the next graph, or its result, is due."""

    def __init__(self) -> None:
        self.keyframes = self.frames = 0
        self.is_pending = False
        self._due = 0  # number of keyframes at which the result is applied
        self._due_frame: int | None = None  # ... or number of frames
        self._next = 0  # number of keyframes from which the next graph may be submitted

    @property
    def may_begin(self) -> bool:
        """Whether enough keyframes were added since the last graph began."""
        return not self.is_pending and self.keyframes >= self._next

    @property
    def is_due(self) -> bool:
        """Whether a result is due by the number of keyframes."""
        return self.is_pending and self.keyframes >= self._due

    def is_due_apart(self) -> bool:
        """Whether a result is due by the number of frames, while the camera is apart."""
        if self.is_pending and self._due_frame is None:
            self._due_frame = self.frames + _FRAME_LATENCY
        return self._due_frame is not None and self.frames >= self._due_frame

    def begin(self, *, is_apart: bool) -> None:
        """A graph is submitted, while the camera is in a segment of its own, or not."""
        self.is_pending, self._due = True, self.keyframes + _LATENCY
        self._due_frame = self.frames + _FRAME_LATENCY if is_apart else None
        spacing = max(_SPACING, math.ceil(_SPACING_RATIO * self.keyframes))
        self._next = self.keyframes + spacing

    def end(self) -> None:
        """The result was taken."""
        self.is_pending, self._due_frame = False, None
