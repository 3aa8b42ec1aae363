"""Visual odometry: the pose of each frame from its images.

The local map holds the newest keyframes and the landmarks that they observe. Each frame is tracked
against it. A frame that sees too little of the map, or sees it from a new side, becomes a keyframe,
which adds landmarks and is optimised together with the keyframes before it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from subprocess import Popen

import cv2

from vo.base.config import Config
from vo.base.failures import Failure
from vo.base.faults import Fault, FaultKind
from vo.base.records.calibration_errors import CalibrationErrors
from vo.base.records.snapshot import Snapshot
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Estimate, Frame, PredictedPose, Rig, State
from vo.engine.frontend.lazy_future import LazyFuture
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.learned.inference import networks_used
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.tracked_frame import TrackedFrame, as_tracked_frame
from vo.engine.snapshot import FrameResult, make_estimate, make_snapshot
from vo.engine.stages import BUILT_IN, Components, make_stages
from vo.engine.trajectory.map_frame import Anchor
from vo.engine.trajectory.store import TrajectoryStore
from vo.engine.warmup import parts_of, warm_up


class Odometry:
    """Computes poses from frames, one `track` a frame; `close` it at the end.

    The number and speed of threads make no difference to any pose.

    Attributes:
        hidden: ratio of the recorded images that masks of the whole run hide, by camera.
        map_alignment: closes loops and uses an inertial sensor, if it is asked to.
        networks: those that have been loaded.

    Args:
        rig: the cameras, as recorded.
        components: parts to be used instead of the built-in ones.
        optimizer_process: that of `vo.engine.backend.launch`, if it was started already.

    Raises:
        CalibrationError, ConfigError: the cameras cannot be rectified, or a mask cannot be used.
    """

    def __init__(
        self,
        rig: Rig,
        config: Config,
        components: Components = BUILT_IN,
        optimizer_process: Popen[bytes] | None = None,
    ) -> None:
        warm_up(Odometry, parts_of(rig, inertial=components.inertial_sensor is not None))
        cv2.setRNGSeed(config.seed)
        self.stopwatch = Stopwatch()
        with networks_used(config.features.device) as self.networks:
            stages = make_stages(rig, config, components, self.stopwatch, optimizer_process)
        self._preprocessor = stages.preprocessor
        self.hidden = stages.preprocessor.hidden
        self._window_optimizer = stages.window_optimizer
        self._tracker = stages.tracker
        self._recovery = stages.recovery
        self._creator = stages.creator
        self._rescue = stages.rescue
        self._policy = stages.policy
        self._forecast = stages.forecast
        self._map = stages.local_map
        self._mapper = stages.mapper
        self._updater = stages.updater
        self._trajectory = stages.trajectory
        self.map_alignment = stages.map_alignment
        self._expects_keyframe = True  # whether the next frame probably becomes a keyframe
        self._result: FrameResult | None = None  # of the newest frame
        self._anchor: Anchor | None = None  # in the map frame, when the newest frame was tracked
        self._has_moved = False  # whether the newest frame has added or moved keyframes

    def track(self, frame: Frame) -> Estimate:
        """Process the next frame."""
        return self._process(self._preprocessor.submit(frame))

    def track_all(self, frames: Iterable[Frame]) -> Iterator[Estimate]:
        """Process frames, each of them preprocessed while the one before it is tracked."""
        for pending in self._preprocessor.ahead(frames):
            yield self._process(pending)

    def locate(self, frame: Frame) -> Estimate:
        """The pose of the next frame, at once.

        The rest is left to `update_map`; keyframes that it adds or moves are in the next estimate.
        """
        self._locate(self._preprocessor.submit(frame))
        return self._estimate()

    def update_map(self) -> None:
        """Make the newest frame a keyframe if the map needs one; in any thread, before the next."""
        result = self._result
        if result is None or not result.is_keyframe or result.keyframe is not None:
            return
        assert result.tracked is not None
        self._result = result._replace(keyframe=self._add_keyframe(result.frame, result.tracked))

    def predict(self, stamp_ns: int) -> PredictedPose | None:
        """The pose after the newest tracked frame, None if it is unknown; after `update_map`."""
        ahead, segment = self._tracker.ahead(stamp_ns), self._recovery.segment
        return self._trajectory.predicted(ahead, segment, self._anchor)

    def finish(self) -> Mapping[str, float]:
        """Apply the last results of the optimizer; the time by stage that it took."""
        self.update_map()
        self._updater.apply()
        self.map_alignment.finish(self._map)
        return self.stopwatch.take()

    def close(self) -> None:
        """Hand the map to the keyframe store, and end threads and processes."""
        self._map.clear()
        self.map_alignment.close()
        self._window_optimizer.close()
        self._preprocessor.close()

    @property
    def trajectory(self) -> TrajectoryStore:
        """The path so far."""
        return self._trajectory.store

    @property
    def calibration_errors(self) -> CalibrationErrors:
        """Errors of the calibration that were found and are corrected."""
        return self._updater.calibration_errors

    def snapshot(self) -> Snapshot:
        """The newest frame and the local map for display, before the next frame is tracked."""
        anchor = self.trajectory.anchor(self._recovery.segment)
        return make_snapshot(self._newest, self._map, anchor, has_moved=self._has_moved)

    @property
    def _newest(self) -> FrameResult:
        if self._result is None:
            raise RuntimeError("no frame has been tracked yet")
        return self._result

    def _process(self, pending: LazyFuture[PreprocessedFrame]) -> Estimate:
        self._locate(pending)
        self.update_map()
        return self._estimate()

    def _locate(self, pending: LazyFuture[PreprocessedFrame]) -> None:
        """Track a frame, and others again where it shows that they were misled or lost."""
        frame = self._preprocess(pending)
        self.update_map()
        self.map_alignment.begin_frame(frame.index, self._recovery.segment, self._map)
        for each in self._recovery.frames(frame):
            self.update_map()
            self._updater.follow(each)
            self._result = self._track(each)
        self._anchor = self._trajectory.store.anchor(self._recovery.segment)
        is_lost = self._recovery.state is not State.TRACKING
        self._preprocessor.is_eager = is_lost or self._forecast.expects_all

    @timed("features")
    def _preprocess(self, pending: LazyFuture[PreprocessedFrame]) -> PreprocessedFrame:
        frame = pending.result()
        if self._expects_keyframe or self._recovery.state is not State.TRACKING:
            frame.start_features()
        return frame

    def _track(self, frame: PreprocessedFrame) -> FrameResult:
        """Align a frame to the last one, track it in the map, and ask whether that needs it."""
        failure = self._recovery.why_useless(frame)
        if failure is not None:
            return FrameResult(frame, failure=failure)
        last, last_from_cam = self._tracker.last, None
        if self._recovery.state is State.TRACKING:
            # The window is optimised at the same time: the result does not depend on it.
            last_from_cam = self._tracker.align_to_last(frame)
        self._updater.next_frame()
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
        return FrameResult(frame, tracked, is_keyframe, last, faults=faults)

    def _needs_keyframe(self, frame: PreprocessedFrame, tracked: TrackedFrame) -> bool:
        change = self._policy.change_since_last(self._map, frame, tracked)
        is_keyframe = self._policy.needs_keyframe(change) and not frame.missing_ratio
        self._expects_keyframe = self._forecast.expects_next(change, is_keyframe=is_keyframe)
        return is_keyframe

    def _add_keyframe(self, frame: PreprocessedFrame, tracked: TrackedFrame) -> Keyframe:
        """Add a keyframe and landmarks, and optimise the newest keyframes."""
        frame.start_features()
        keyframe = self._mapper.add_keyframe(frame, tracked, self._recovery.segment)
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
        return FrameResult(frame, tracked, is_keyframe=True, keyframe=keyframe)

    def _estimate(self) -> Estimate:
        """The newest frame's result."""
        result, segment, path = self._newest, self._recovery.segment, self._trajectory
        moved = path.take_moved()
        self._has_moved = bool(moved)
        pose = result.world_from_cam
        return replace(
            make_estimate(result, self._recovery.state, segment),
            world_from_cam0=None if pose is None else path.map_from_cam0(pose, self._anchor),
            predicted=path.predicted(result.predicted, segment, self._anchor),
            faults=result.every_fault + self._updater.faults,
            keyframes=moved,
            landmark_ids=self._map.id.copy() if moved else None,
            stage_ms=self.stopwatch.take(),
            disparity_offset_px=self._map.rig.disparity_offset_px,
        )
