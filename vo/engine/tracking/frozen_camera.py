"""Images that repeat while the camera moves, told from a camera that stands still.

A camera that was moving cannot stop within a frame and without a trace. Images that repeat then
show an earlier time than their stamps say, and get no pose. If the first image that differs shows
that the camera has hardly moved after all, it did stand still, and they get its pose afterwards.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.types import Floats, Ints
from vo.engine.frontend.image_repetition import Repetition
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import FrameId
from vo.engine.mapping.tracked_frame import LastFrame, TrackedFrame

# Predicted motion in the image from which a repeated image is impossible. What differs by noise
# may also be a camera that stops: it must have been faster, and the frame rate higher.
_MIN_MOTION_PX = {Repetition.IDENTICAL: 0.3, Repetition.SIMILAR: 2.0}
_MAX_INTERVAL_S = {Repetition.IDENTICAL: 0.5, Repetition.SIMILAR: 0.25}
# Images that differ by noise for longer than this are those of a camera that stands still, and so
# are more identical ones than this where the motion before is unknown.
_MAX_SIMILAR_S = 5.0
_MAX_UNKNOWN = 3
_STILL_PX = 1.0  # motion of landmarks from which the camera goes on, whatever noise hides
_MAX_START_RATIO = 1.2  # of the motion in the first frame after a stop to that before it


class MovingTracker(Protocol):
    """What is asked of `Tracker`, and of one view of a rig."""

    @property
    def knows_velocity(self) -> bool:
        """Whether two frames of the segment have been tracked."""
        ...

    @property
    def last(self) -> LastFrame | None:
        """The last tracked frame."""
        ...

    def motion_px(self, ids: Ints, stamp_ns: int, last_from_cam: Floats | None = None) -> float:
        """Median motion of landmarks in the image from the last frame to a time or a pose, or 0."""
        ...

    def align_to_last(self, frame: PreprocessedFrame) -> Floats | None:
        """last_from_cam (4, 4) by sparse image alignment; None if it fails."""
        ...


class FrozenCamera:
    """Withholds poses from repeated images of a moving camera."""

    def __init__(self, tracker: MovingTracker) -> None:
        self._tracker = tracker
        self._withheld: list[FrameId] = []
        self._stamp_ns = 0  # of the frame before

    @property
    def has_withheld(self) -> bool:
        """Whether the frames before this one have no pose because their images repeat."""
        return bool(self._withheld)

    def is_frozen(self, frame: PreprocessedFrame, segment: int) -> bool:
        """Whether a frame repeats the one before, although the camera moves."""
        interval_s, self._stamp_ns = (frame.stamp_ns - self._stamp_ns) * 1e-9, frame.stamp_ns
        repetition, last = frame.repetition, self._tracker.last
        if last is None:
            self._withheld = []  # those of the segment before stay without a pose
        if repetition is Repetition.NONE or last is None:
            return False
        if not self._tracker.knows_velocity:
            is_frozen = repetition is Repetition.IDENTICAL and len(self._withheld) < _MAX_UNKNOWN
        elif self._withheld:
            since_s = (frame.stamp_ns - self._withheld[0].stamp_ns) * 1e-9
            is_frozen = repetition is Repetition.IDENTICAL or since_s <= _MAX_SIMILAR_S
        else:
            is_frozen = self._is_moving(frame, last, interval_s)
        if is_frozen:
            self._withheld.append(FrameId(frame.index, frame.stamp_ns, segment))
        return is_frozen

    def resume(self, tracked: TrackedFrame) -> list[FrameId]:
        """Continue with a tracked frame.

        Returns:
            The frames before it that have the last pose after all: the camera had stopped.
        """
        withheld, self._withheld = self._withheld, []
        return withheld if withheld and self._has_stood(tracked, withheld[0]) else []

    def _is_moving(self, frame: PreprocessedFrame, last: LastFrame, interval_s: float) -> bool:
        ids = last.ids[last.inlier]
        motion_px = self._tracker.motion_px(ids, frame.stamp_ns)
        kind = frame.repetition
        if motion_px < _MIN_MOTION_PX[kind] or interval_s > _MAX_INTERVAL_S[kind]:
            return False
        moved = None if kind is Repetition.IDENTICAL else self._tracker.align_to_last(frame)
        return moved is None or self._tracker.motion_px(ids, frame.stamp_ns, moved) < _STILL_PX

    def _has_stood(self, tracked: TrackedFrame, first: FrameId) -> bool:
        """Whether landmarks have moved since the last frame as in one frame before it.

        A camera that starts again hardly moves more in a frame than before; one that went on while
        the images repeated has moved for at least two frames.
        """
        last = self._tracker.last
        assert last is not None  # without one no frame is withheld
        ids, now, before = np.intersect1d(
            tracked.ids[tracked.inlier], last.ids, assume_unique=True, return_indices=True
        )
        if len(ids) == 0:
            return False
        motion = tracked.observed.image_xy[tracked.inlier][now] - last.image_xy[before]
        moved_px = median(np.hypot(motion[:, 0], motion[:, 1]))
        usual_px = self._tracker.motion_px(ids, first.stamp_ns)
        return moved_px < max(_MAX_START_RATIO * usual_px, _MIN_MOTION_PX[Repetition.IDENTICAL])
