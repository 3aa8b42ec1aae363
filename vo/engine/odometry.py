"""Visual odometry: the pose of each frame from its images.

The local map holds the newest keyframes and the landmarks that they observe. Each frame is tracked
against it. A frame that sees too little of the map, or sees it from a new side, becomes a keyframe,
which adds landmarks and is optimised together with the keyframes before it.
"""

from __future__ import annotations

import cv2

from vo.base.config import Config
from vo.base.failures import Failure
from vo.base.faults import Fault, FaultKind
from vo.base.records.calibration_errors import CalibrationErrors
from vo.base.stopwatch import timed
from vo.base.types import Rig, State
from vo.engine.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.engine.learned.inference import networks_used
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.tracked_frame import TrackedFrame, as_tracked_frame
from vo.engine.odometry_base import OdometryBase
from vo.engine.recovery import Recovery
from vo.engine.snapshot import FrameResult
from vo.engine.stages import BUILT_IN, Components, make_stages
from vo.engine.tracking.tracker import Tracker
from vo.engine.warmup import parts_of, warm_up


class Odometry(OdometryBase[PreprocessedFrame]):
    """The odometry of one or two cameras.

    The number and speed of threads make no difference to any pose.

    Args:
        rig: the cameras, as recorded.
        components: parts to be used instead of the built-in ones.

    Raises:
        CalibrationError, ConfigError: the cameras cannot be rectified, or a mask cannot be used.
    """

    def __init__(
        self,
        rig: Rig,
        config: Config,
        components: Components = BUILT_IN,
    ) -> None:
        super().__init__()
        warm_up(Odometry, parts_of(rig, inertial=components.inertial_sensor is not None))
        cv2.setRNGSeed(config.seed)
        with networks_used(config.features.device) as self.networks:
            stages = make_stages(rig, config, components, self.stopwatch)
        self._preprocessor: FramePreprocessor = stages.preprocessor
        self.hidden = stages.preprocessor.hidden
        self._window_optimizer = stages.window_optimizer
        self._tracker: Tracker = stages.tracker
        self._recovery: Recovery = stages.recovery
        self._creator = stages.creator
        self._rescue = stages.rescue
        self._policy = stages.policy
        self._forecast = stages.forecast
        self._map = stages.local_map
        self._mapper = stages.mapper
        self._updater = stages.updater
        self._trajectory = stages.trajectory
        self.map_alignment = stages.map_alignment
        self._expects_keyframe = True

    @property
    def calibration_errors(self) -> CalibrationErrors:
        """Errors of the calibration that were found and are corrected."""
        return self._updater.calibration_errors

    @property
    def _faults(self) -> tuple[Fault, ...]:
        return self._updater.faults

    @property
    def _expects_all(self) -> bool:
        return self._forecast.expects_all

    def _apply(self) -> None:
        self._updater.finish()

    def _next_frame(self) -> None:
        self._updater.next_frame()

    def _count_early(self) -> bool:
        return self._tracker.keep_last() and super()._count_early()

    def _track(self, frame: PreprocessedFrame) -> FrameResult:
        """Align a frame to the last one, track it in the map, and ask whether that needs it."""
        self._updater.follow(frame)
        failure = self._recovery.why_useless(frame)
        if failure is not None:
            return FrameResult(frame, failure=failure)
        last, last_from_cam = self._tracker.last, None
        if self._recovery.state is State.TRACKING:
            # The window is optimised at the same time: the result does not depend on it.
            last_from_cam = self._tracker.align_to_last(frame)
        self._count_frame()
        self._updater.suspend_if_ambiguous(frame)
        if self._recovery.state is State.STARTING:
            return self._start(frame)
        frame, tracked = self._recovery.track(frame, last_from_cam)
        if isinstance(tracked, Failure):
            return FrameResult(frame, failure=tracked, predicted=self._tracker.predicted(frame))
        newest = self._map.keyframes[-1]
        for each in self._recovery.resume(tracked):
            self._trajectory.add_frame(each, newest, self._tracker.last_pose)
        faults = self._tracker.update(frame, tracked)
        is_keyframe = self._needs_keyframe(frame, tracked)
        if is_keyframe:
            if tracked.lacks_disparities and self._preprocessor.are_exchanged(frame):
                faults += (Fault(FaultKind.EXCHANGED_IMAGES),)
            frame = self._rescue.at_keyframe(frame)
        else:
            self._trajectory.add_frame(frame, newest, tracked.world_from_cam)
            self.map_alignment.see_frame(frame, tracked, newest)
            self._updater.refit.add(frame.index, tracked)
        return FrameResult(frame, tracked, is_keyframe, last, faults=faults)

    def _needs_keyframe(self, frame: PreprocessedFrame, tracked: TrackedFrame) -> bool:
        change = self._policy.change_since_last(self._map, frame, tracked)
        is_keyframe = self._policy.needs_keyframe(change) and not frame.missing_ratio
        self._expects_keyframe = self._forecast.expects_next(change, is_keyframe=is_keyframe)
        return is_keyframe

    def _add_keyframe(self, result: FrameResult) -> Keyframe:
        """Add a keyframe and landmarks, and optimise the newest keyframes."""
        frame, tracked = result.frame, result.tracked
        assert tracked is not None
        frame.start_features()
        keyframe = self._mapper.add_keyframe(frame, tracked, self._recovery.segment)
        self._updater.refit.add_keyframe(frame.index, tracked)
        if self._map.rig.is_metric:  # the window is optimised while the map grows
            self._updater.add_keyframe(keyframe)
            self._mapper.extend(keyframe, frame)
        else:  # new landmarks of a single camera must be optimised before they are used
            self._mapper.extend(keyframe, frame)
            self._updater.add_keyframe(keyframe)
        self.map_alignment.see_keyframe(keyframe, frame)
        return keyframe

    @timed("start")
    def _start(self, frame: PreprocessedFrame) -> FrameResult:
        """Create the first map of a segment, where a frame allows it."""
        keyframe = self._creator.create_map(frame, self._tracker.last_pose, self._recovery.segment)
        if isinstance(keyframe, Failure):
            return FrameResult(frame, failure=keyframe)
        frame = self._recovery.start(frame)
        self._updater.add_keyframe(keyframe)
        self.map_alignment.see_keyframe(keyframe, frame)
        tracked = as_tracked_frame(self._map, keyframe)
        self._tracker.restart(frame, tracked)
        self._updater.refit.forget()
        self._updater.refit.add_keyframe(frame.index, tracked)
        return FrameResult(frame, tracked, is_keyframe=True, keyframe=keyframe)
