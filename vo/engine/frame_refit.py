"""What frames between keyframes measure, once windows have moved their landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.tracking.pose_estimation import PoseEstimator
from vo.engine.trajectory.builder import TrajectoryBuilder

# Intervals between keyframes that wait. Landmarks hardly move later, and more of them are removed.
_WAITING = 5
_MAX_FRAMES = 200  # of an interval, 20 kB each; more while the camera stands still


class FrameRefit:
    """Fits frames again to the landmarks by which they were tracked.

    The keyframes beside them are fitted by the same landmarks, so that errors which they have in
    common with the frames between cancel: only motions from frame to frame are used.
    """

    def __init__(self, estimator: PoseEstimator, trajectory: TrajectoryBuilder) -> None:
        self._estimator = estimator
        self._trajectory = trajectory
        # Frames from each keyframe to the next one, with their numbers; the last is still open.
        self._intervals: list[list[tuple[int, TrackedFrame]]] = []

    def add_keyframe(self, frame_index: int, tracked: TrackedFrame) -> None:
        """Keep a keyframe as it was tracked."""
        self.add(frame_index, tracked)
        self._intervals.append([(frame_index, tracked)])

    def add(self, frame_index: int, tracked: TrackedFrame) -> None:
        """Keep a frame until windows have moved its landmarks."""
        if self._intervals:
            self._intervals[-1].append((frame_index, tracked))
            if len(self._intervals[-1]) > _MAX_FRAMES:
                self.forget()

    def forget(self) -> None:
        """Leave the frames that are kept as they are: their map or its calibration is another."""
        self._intervals = []

    def update(self) -> None:
        """Fit the frames of intervals that have waited, after a window."""
        while len(self._intervals) > _WAITING:
            self._fit(self._intervals.pop(0))

    def finish(self) -> None:
        """Fit all frames, after the last window."""
        for interval in self._intervals:
            self._fit(interval)
        self.forget()

    def _fit(self, interval: Sequence[tuple[int, TrackedFrame]]) -> None:
        """Fit the frames from a keyframe to the next one, or all of the last interval."""
        if len(interval) < 3:  # there is nothing between
            return
        numbers = [number for number, _ in interval]
        poses = []
        for _, tracked in interval:
            pose = self._estimator.refit(tracked)
            if pose is None:
                return
            poses.append(pose)
        self._trajectory.measure(numbers[1:], inverse(poses[0]) @ np.stack(poses[1:]))
