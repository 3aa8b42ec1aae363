"""Visual odometry of a rig of any number of cameras, whose images may overlap or not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from subprocess import Popen
from typing import Any

import cv2
import numpy as np

from vo.base.config import Config
from vo.base.failures import Failure, FailureReason
from vo.base.geometry.rig_overlap import overlaps
from vo.base.geometry.transforms import interpolate, inverse, orthonormalised
from vo.base.records.calibration_errors import CalibrationErrors
from vo.base.records.metric_scale import MetricScale, ScaleFindings, ScaleSource
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.snapshot import FurtherImage, Snapshot
from vo.base.scheduling import available_cores
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Estimate, Floats, Frame, PredictedPose, Rig, State
from vo.engine.backend.optimizer import make_optimizer
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.lazy_future import LazyFuture
from vo.engine.frontend.static_masks import recorded_masks
from vo.engine.map_alignment import MapAlignment
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.mapping.tracked_frame import LastFrame
from vo.engine.odometry import Odometry
from vo.engine.rig.extrinsics import RigExtrinsics
from vo.engine.rig.frames import RigFrame, RigPreprocessor
from vo.engine.rig.mapper import RigMapper
from vo.engine.rig.policy import RigKeyframePolicy
from vo.engine.rig.starter import Metre, RigStarter
from vo.engine.rig.tracked import LastRigFrame, RigTracked
from vo.engine.rig.tracker import RigTracker
from vo.engine.rig.views import rig_views
from vo.engine.rig.window import RigWindow, rig_window_size
from vo.engine.snapshot import FrameResult, make_estimate, make_snapshot
from vo.engine.stages import BUILT_IN, Components
from vo.engine.trajectory.builder import TrajectoryBuilder
from vo.engine.trajectory.store import TrajectoryStore
from vo.engine.warmup import warm_up

_SETTLING = 3  # frames until the velocity is known, where images have different times


class RigOdometry:
    """Computes poses from frames of a rig, one `track` a frame; `close` it at the end.

    The same calls as of `vo.engine.odometry.Odometry`; loops, inertial sensors and markers are not
    used.

    Args:
        rig: the cameras, as recorded.
        components: `extractor` and `matcher` may be given.
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
        warm_up(Odometry)
        cv2.setRNGSeed(config.seed)
        self.stopwatch = Stopwatch()
        self.networks: list[Any] = []
        self.map_alignment = MapAlignment(None, None)
        masks = recorded_masks(config.masks, rig)
        self.hidden = tuple(0.0 if m is None else float(np.mean(m == 0)) for m in masks)
        self._views = rig_views(rig, masks)
        self._overlapping = overlaps(rig)
        count, rectified = len(self._views.views), self._views.rectified
        frontend = make_frontend(config, components.extractor, components.matcher)
        threads = config.threads or available_cores()
        self._preprocessor = RigPreprocessor(self._views, frontend.extractor, threads)
        size = rig_window_size(config.smoothing, count)
        capacity = count * (size.free + size.fixed)
        self._map = LocalMap(rectified, capacity, frontend.extractor.descriptor_format)
        self._trajectory = TrajectoryBuilder(rectified.cam0_from_rectified, is_metric=True)
        self._mapper = RigMapper(self._map, frontend, config.mapping, self.stopwatch, count)
        tied = self._views.body_from_views
        self._tracker = RigTracker(self._map, frontend, config.tracking, tied, self.stopwatch)
        self._optimizer = make_optimizer(config.smoothing, threads, optimizer_process)
        parts = self._map, self._optimizer, config.smoothing, self.stopwatch
        self._window = RigWindow(*parts, self._views.cameras, self._unknown_lever)
        self._extrinsics = RigExtrinsics(tied, self._views.cameras)
        self._instants = size.free + size.fixed
        local_mapper = LocalMapper(self._map, frontend, config.mapping, self.stopwatch)
        self._starter = RigStarter(self._map, local_mapper, frontend, config)
        self.metre = Metre()
        self.scale_sources: tuple[ScaleSource, ...] = ()
        self._metres: dict[int, MetricScale] = {}  # by segment that began without a scale
        self._policy = RigKeyframePolicy(config, count)
        self._unsettled = 0  # frames to make the first map anew, as the velocity was unknown
        self._config = config
        self._state = State.STARTING
        self._segment = 0
        self._lost = 0
        self._newest: FrameResult | None = None
        self._frame: RigFrame | None = None
        self._tracked: RigTracked | None = None
        self._needs_keyframe = False
        self._has_moved = False

    def track(self, frame: Frame) -> Estimate:
        """Process the next frame."""
        return self._process(self._preprocessor.submit(frame))

    def track_all(self, frames: Iterable[Frame]) -> Iterator[Estimate]:
        """Process frames, each of them preprocessed while the one before it is tracked."""
        for pending in self._preprocessor.ahead(frames):
            yield self._process(pending)

    def locate(self, frame: Frame) -> Estimate:
        """The pose of the next frame, at once; the rest is left to `update_map`."""
        self._locate(self._preprocessor.submit(frame))
        return self._estimate()

    def update_map(self) -> None:
        """Make the newest frame a keyframe if the map needs one; in any thread, before the next."""
        if self._needs_keyframe and self._frame is not None and self._tracked is not None:
            self._needs_keyframe = False
            keyframe = self._add_keyframe(self._frame, self._tracked)
            assert self._newest is not None
            self._newest = self._newest._replace(keyframe=keyframe)

    def predict(self, stamp_ns: int) -> PredictedPose | None:
        """The pose after the newest tracked frame, None if it is unknown; after `update_map`."""
        ahead = None if self._tracker.last is None else self._tracker.motion.ahead(stamp_ns)
        return self._trajectory.predicted(ahead, self._segment, None)

    def finish(self) -> Mapping[str, float]:
        """Apply the last result of the optimizer; the time by stage that it took."""
        self.update_map()
        self._apply()
        self._note_metre()
        return self.stopwatch.take()

    def close(self) -> None:
        """End threads and processes."""
        self._optimizer.close()
        self._preprocessor.close()

    @property
    def trajectory(self) -> TrajectoryStore:
        """The path so far."""
        return self._trajectory.store

    @property
    def calibration_errors(self) -> CalibrationErrors:
        """Errors of the calibration that were found and are corrected."""
        return CalibrationErrors(0.0, 0.0, None, None, self._extrinsics.errors)

    def snapshot(self) -> Snapshot:
        """The newest frame in view 0, and the local map, before the next frame is tracked."""
        if self._newest is None:
            raise RuntimeError("no frame has been tracked yet")
        shown = make_snapshot(self._newest, self._map, None, has_moved=self._has_moved)
        shown = replace(shown, view=replace(shown.view, further=self._further_images()))
        if shown.landmarks is None:
            return shown
        of_view = shown.landmarks.sightings[:: len(self._views.views)]
        return replace(shown, landmarks=replace(shown.landmarks, sightings=of_view))

    def _further_images(self) -> tuple[FurtherImage, ...]:
        """The views besides the first, of the newest frame."""
        assert self._frame is not None
        cam0_from_body, found = self._views.rectified.cam0_from_rectified, []
        cameras = [view.camera for view in self._views.views]
        for number, view in enumerate(self._views.views):
            name = f"cam{view.camera}" + "_2" * (view.camera in cameras[:number])
            image = self._frame.views[number].image0 if self._frame.used[number] else None
            found.append(
                FurtherImage(name, image, cam0_from_body @ self._extrinsics.body_from_views[number])
            )
        return tuple(found[1:])

    def _process(self, pending: LazyFuture[RigFrame]) -> Estimate:
        self._locate(pending)
        self.update_map()
        return self._estimate()

    def _locate(self, pending: LazyFuture[RigFrame]) -> None:
        """Track a frame in the map, or start a map with it."""
        frame = self._preprocess(pending)
        self.update_map()
        self._trajectory.reach(frame.views[0])
        if self._window.next_frame():
            self._apply()
        if self._state is not State.STARTING and self._lost > self._config.tracking.recover_frames:
            self._give_up()
        before = None
        if self._tracker.last is not None:
            last = self._tracker.last
            seen = last.tracked.views[0]
            before = LastFrame(last.frame.views[0], seen.ids, seen.observed.image_xy, seen.inlier)
        failure: Failure | None = None
        if self._state is State.STARTING:
            tracked, keyframe, failure = self._start(frame)
        else:
            keyframe = None
            tracked = self._tracker.track(frame, is_lost=self._state is State.LOST)
            failure = Failure(FailureReason.FEW_INLIERS) if tracked is None else None
            self._take_in(frame, tracked)
        self._frame, self._tracked = frame, tracked
        self._newest = FrameResult(
            frame.views[0],
            None if tracked is None else tracked.views[0],
            self._needs_keyframe or keyframe is not None,
            before,
            failure,
            frame.faults,
            keyframe,
        )
        self._preprocessor.is_eager = self._state is not State.TRACKING

    @timed("features")
    def _preprocess(self, pending: LazyFuture[RigFrame]) -> RigFrame:
        return pending.result()

    def _take_in(self, frame: RigFrame, tracked: RigTracked | None) -> None:
        """Continue from a frame, or count it as lost."""
        if tracked is None:
            self._state, self._lost = State.LOST, self._lost + 1
            return
        self._state, self._lost = State.TRACKING, 0
        self._window.retie(self._tracker.update(frame, tracked))
        if self._unsettled > 0 and self.metre.is_known:
            self._settle(frame, tracked)
            return
        last = self._mapper.newest
        self._needs_keyframe = self._policy.needs_keyframe(self._map, last, frame, tracked)
        if not self._needs_keyframe:
            self._trajectory.add_frame(frame.views[0], last[0], tracked.world_from_body)

    def _settle(self, frame: RigFrame, tracked: RigTracked) -> None:
        """Make the first map anew: that before had images of different times as if at rest."""
        self._unsettled -= 1
        self._apply()
        self._map.clear()
        tied, pose = tracked.body_from_views, tracked.world_from_body
        keyframe = self._mapper.add_first_instant(frame, pose, tied, self._segment)
        self._mapper.extend(frame)
        if len(self._map) < self._config.start.min_points:
            self._state = State.STARTING
            return
        self._trajectory.add_keyframe(keyframe)
        self._tracker.last = LastRigFrame(frame, self._mapper.as_tracked(tied))

    def _add_keyframe(self, frame: RigFrame, tracked: RigTracked) -> Keyframe:
        frame.start_features()
        keyframe = self._mapper.add_instant(frame, tracked, self._segment)
        self._trajectory.add_keyframe(keyframe)
        self._apply()
        self._window.submit(calibration_weight=self._extrinsics.next_weight())
        self._mapper.extend(frame)
        return keyframe

    def _give_up(self) -> None:
        """Start a new segment."""
        self._apply()
        self._note_metre()
        self._map.clear()
        self._tracker.last = None
        self._state, self._lost = State.STARTING, 0
        self._segment += 1

    @timed("start")
    def _start(self, frame: RigFrame) -> tuple[RigTracked | None, Keyframe | None, Failure | None]:
        """A map from the views of one frame that overlap, or from two frames of one camera."""
        needed, pose = self._config.start.min_points, self._tracker.motion.last
        self._set_metre(is_known=True)
        self._mapper.add_first_instant(frame, pose, self._tracker.body_from_views, self._segment)
        self._mapper.extend(frame)
        found = len(self._map)
        if found < needed:
            self._map.clear()
            if self._overlapping:
                return None, None, Failure(FailureReason.FEW_LANDMARKS, found, needed)
            failure = self._start_by_motion(frame, pose)
            if failure is not None:
                return None, None, failure
        keyframe = self._mapper.newest[0]
        tracked = self._mapper.as_tracked(self._tracker.body_from_views)
        self._state = State.TRACKING
        self._starter.restart()
        self._tracker.restart(frame, tracked)
        self._trajectory.add_keyframe(keyframe)
        self._unsettled = _SETTLING if any(frame.delay_s) else 0
        if not self.metre.is_known:
            self._window.submit()
            self._apply()
        return tracked, keyframe, None

    def _start_by_motion(self, frame: RigFrame, pose: Floats) -> Failure | None:
        """A map from two frames, in which the length of a metre is unknown."""
        pair = self._starter.attempt(frame, self._tracker.body_from_views)
        if isinstance(pair, Failure):
            return pair
        self._set_metre(is_known=False)
        self.scale_sources = (self,)
        tied = self._tracker.body_from_views
        first = self._mapper.add_first_instant(pair.first, pose, tied, self._segment)
        self._mapper.add_first_instant(frame, pose @ pair.motion, tied, self._segment)
        self._mapper.newest[0].covariance = None
        self._mapper.extend(frame, depth=1.0)
        needed = self._config.start.min_points
        if len(self._map) < needed:
            found = len(self._map)
            self._map.clear()
            return Failure(FailureReason.FEW_LANDMARKS, found, needed)
        self._trajectory.add_keyframe(first)
        for n, each in enumerate(pair.between, 1):
            guess = interpolate(pose, pose @ pair.motion, n / (len(pair.between) + 1))
            tracked = self._tracker.refine(each, guess)
            if tracked is not None:
                self._trajectory.add_frame(each.views[0], first, tracked.world_from_body)
        return None

    def _set_metre(self, *, is_known: bool) -> None:
        self.metre.restart(is_known=is_known)
        self._trajectory.store.metric.by_cameras = is_known
        self._place_views()

    def _place_views(self) -> None:
        """Place the views on the body, in units of the map."""
        tied = self._extrinsics.body_from_views.copy()
        tied[:, :3, 3] *= self.metre.length
        self._tracker.body_from_views = tied

    def _unknown_lever(self) -> tuple[Floats, float] | None:
        """Translations (V, 3) of the views in metres, where a metre's length is unknown."""
        if self.metre.is_known:
            return None
        return self._extrinsics.body_from_views[:, :3, 3], self.metre.information

    def _note_metre(self) -> None:
        """Keep the scale of a segment that began without one."""
        if self.metre.is_known or not np.isfinite(self.metre.relative_sigma):
            return
        value = 1.0 / self.metre.length
        sigma = value * self.metre.relative_sigma
        self._metres[self._segment] = MetricScale(self._segment, value, sigma, "turns of the rig")

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """See `ScaleSource.observe`; nothing is left to see."""

    def measure(self, path: PosedFrames) -> ScaleFindings:
        """The scales of segments that began without one; see `ScaleSource.measure`."""
        return ScaleFindings(tuple(self._metres.values()))

    def _apply(self) -> None:
        """Apply the pending window, and move the tracker with its newest keyframe."""
        update = self._window.apply()
        while update is not None:
            self._trajectory.update(update.moved)
            if not self.metre.is_known:
                self.metre.update(*self._window.metre, self._instants)
                self._place_views()
            self._mapper.cull()
            self._mapper.estimate_normals()
            count = len(self._views.views)
            before = update.window.problem.world_from_cam[-count]
            now = update.window.keyframes[-count].world_from_cam
            self._tracker.motion.move(orthonormalised(now @ inverse(before)))
            update = self._extrinsics.correct(self._window, self._tracker)

    def _estimate(self) -> Estimate:
        """The newest frame's result."""
        result, path, tracked = self._newest, self._trajectory, self._tracked
        assert result is not None
        moved = path.take_moved()
        self._has_moved = bool(moved)
        pose = None if tracked is None else tracked.world_from_body
        estimate = make_estimate(result, self._state, self._segment)
        seen = () if tracked is None else tracked.views
        matches = sum(len(view.observed) for view in seen)
        return replace(
            estimate,
            world_from_cam0=None if pose is None else path.world_from_cam0(pose),
            faults=result.every_fault,
            features=max(matches, estimate.features),
            matches=matches,
            inliers=sum(view.inliers for view in seen),
            keyframes=moved,
            landmark_ids=self._map.id.copy() if moved else None,
            stage_ms=self.stopwatch.take(),
        )
