"""Visual odometry of a rig of any number of cameras, whose images may overlap or not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

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
from vo.base.stopwatch import timed
from vo.base.types import Estimate, Floats, Rig, State
from vo.engine.backend.optimizer import make_optimizer
from vo.engine.frontend.frontend import make_frontend
from vo.engine.frontend.static_masks import recorded_masks
from vo.engine.map_alignment import MapAlignment
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.odometry import Odometry
from vo.engine.odometry_base import OdometryBase
from vo.engine.recovery import LossPolicy, Segments
from vo.engine.rig.extrinsics import RigExtrinsics
from vo.engine.rig.frames import RigFrame, RigPreprocessor
from vo.engine.rig.frozen import BestView
from vo.engine.rig.mapper import RigMapper
from vo.engine.rig.policy import RigKeyframePolicy
from vo.engine.rig.starter import Metre, RigStarter
from vo.engine.rig.tracked import LastRigFrame, RigTracked
from vo.engine.rig.tracker import RigTracker
from vo.engine.rig.views import rig_views
from vo.engine.rig.window import RigWindow, rig_window_size
from vo.engine.snapshot import FrameResult
from vo.engine.stages import BUILT_IN, Components, inertial_parts, memory_of_run
from vo.engine.tracking.frozen_camera import FrozenCamera
from vo.engine.trajectory.builder import TrajectoryBuilder
from vo.engine.warmup import warm_up

_SETTLING = 3  # frames until the velocity is known, where images have different times


class RigOdometry(OdometryBase[RigFrame]):
    """The odometry of a rig.

    Its first view alone closes loops.

    Args:
        rig: the cameras, as recorded.
        components: `extractor`, `matcher` and an inertial sensor may be given.

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
        warm_up(Odometry)
        cv2.setRNGSeed(config.seed)
        self.networks = []
        masks = recorded_masks(config.masks, rig)
        self.hidden = tuple(0.0 if m is None else float(np.mean(m == 0)) for m in masks)
        self._views = rig_views(rig, masks)
        self._overlapping = overlaps(rig)
        count, rectified = len(self._views.views), self._views.rectified
        frontend = make_frontend(config, components.extractor, components.matcher)
        threads = config.threads or available_cores()
        self._preprocessor = RigPreprocessor(self._views, frontend.extractor, threads)
        size = rig_window_size(config.smoothing, self._views.body_from_views)
        descriptors = frontend.extractor.descriptor_format
        path = TrajectoryBuilder(rectified.cam0_from_rectified, is_metric=True)
        is_metric = bool(self._overlapping)
        of_sensor = components, rectified, path, self.stopwatch
        motion, predictor, inertial = inertial_parts(*of_sensor, is_metric=is_metric)
        found = rectified, descriptors, config, path, self.stopwatch, inertial
        memory = memory_of_run(*found, is_metric=True) if is_metric else None
        self._trajectory, self.map_alignment = path, MapAlignment(memory, inertial)
        stores, capacity = [] if memory is None else [memory], count * (size.free + size.fixed)
        self._map = LocalMap(rectified, capacity, descriptors, stores, views=count)
        self._mapper = RigMapper(self._map, frontend, config.mapping, self.stopwatch, count)
        tied = self._views.body_from_views
        parts = self._map, frontend, config.tracking, tied, self.stopwatch
        self._tracker: RigTracker = RigTracker(*parts, motion)
        self._best = BestView(self._tracker, self._map)
        self._frozen = FrozenCamera(self._best)
        self._window_optimizer = make_optimizer(config.smoothing, threads)
        of_window = self._map, self._window_optimizer, config.smoothing, self.stopwatch, size
        self._window = RigWindow(*of_window, self._views.cameras, self._unknown_lever)
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
        losses = LossPolicy(config.tracking.recover_frames, predictor)
        self._recovery = Segments(losses, self._give_up)
        self._newest_rig: tuple[RigFrame, RigTracked | None] | None = None

    def finish(self) -> Mapping[str, float]:
        """See `OdometryBase.finish`."""
        stage_ms = super().finish()
        self._note_metre()
        return stage_ms

    @property
    def calibration_errors(self) -> CalibrationErrors:
        """Errors of the calibration that were found and are corrected."""
        return CalibrationErrors(0.0, 0.0, None, None, self._extrinsics.errors)

    def corrected(self, rig: Rig) -> Rig:
        """See `OdometryBase.corrected`."""
        if not self._extrinsics.errors:
            return rig
        moved = self._extrinsics.moved_cameras(self._views.rectified.cam0_from_rectified)
        _, *others = (by @ pose for by, pose in zip(moved, rig.cam0_from_cams, strict=True))
        further = (
            m._replace(cam0_from_cam=p) for m, p in zip(rig.further, others[1:], strict=True)
        )
        return replace(rig, cam1_from_cam0=inverse(others[0]), further=tuple(further))

    def snapshot(self) -> Snapshot:
        """The newest frame in view 0, and the local map, before the next frame is tracked."""
        shown = super().snapshot()
        shown = replace(shown, view=replace(shown.view, further=self._further_images()))
        if shown.landmarks is None:
            return shown
        of_view = shown.landmarks.sightings[:: len(self._views.views)]
        return replace(shown, landmarks=replace(shown.landmarks, sightings=of_view))

    def _further_images(self) -> tuple[FurtherImage, ...]:
        """The views besides the first, of the newest frame."""
        assert self._newest_rig is not None
        frame, _ = self._newest_rig
        cam0_from_body, found = self._views.rectified.cam0_from_rectified, []
        cameras = [view.camera for view in self._views.views]
        for number, view in enumerate(self._views.views):
            before = cameras[:number].count(view.camera)
            name = f"cam{view.camera}" + (f"_{before + 1}" if before else "")
            image = frame.views[number].image0 if frame.used[number] else None
            found.append(
                FurtherImage(name, image, cam0_from_body @ self._extrinsics.body_from_views[number])
            )
        return tuple(found[1:])

    def _next_frame(self) -> None:
        if self._window.next_frame():
            self._apply()

    def _track(self, frame: RigFrame) -> FrameResult:
        """Track a frame in the map, or start a map with it."""
        self._trajectory.reach(frame.views[0])
        self._count_frame()
        before = None if self._tracker.last is None else self._tracker.last.in_view(0)
        if self._frozen.is_frozen(frame.views[self._best.number], self._recovery.segment):
            self._newest_rig = frame, None
            failure = Failure(FailureReason.REPEATED_IMAGE)
            return FrameResult(frame.views[0], failure=failure, faults=frame.faults)
        if self._recovery.state is State.STARTING:
            tracked, keyframe = self._start(frame)
        else:
            is_lost = self._recovery.state is State.LOST or self._frozen.has_withheld
            tracked, keyframe = self._tracker.track(frame, is_lost=is_lost), None
        is_keyframe, view = keyframe is not None, frame.views[0]
        if isinstance(tracked, Failure):
            if self._recovery.state is not State.STARTING:
                self._recovery.lose(frame)
            self._newest_rig = frame, None
            predicted = self._tracker.motion.of_lost(frame.stamp_ns)
            return FrameResult(view, failure=tracked, predicted=predicted, faults=frame.faults)
        if keyframe is None:
            is_keyframe = self._take_in(frame, tracked)
        self._newest_rig = frame, tracked
        seen = view, tracked.body, is_keyframe, before
        return FrameResult(*seen, faults=frame.faults, keyframe=keyframe)

    def _take_in(self, frame: RigFrame, tracked: RigTracked) -> bool:
        """Continue from a frame; whether it is to become a keyframe."""
        self._recovery.found()
        for each in self._frozen.resume(tracked.views[self._best.number]):
            self._trajectory.add_frame(each, self._mapper.newest[0], self._tracker.motion.last)
        self._window.retie(self._tracker.update(frame, tracked))
        if self._unsettled > 0 and self.metre.is_known:
            self._settle(frame, tracked)
            return False
        last = self._mapper.newest
        if self._policy.needs_keyframe(self._map, last, frame, tracked):
            return True
        self._trajectory.add_frame(frame.views[0], last[0], tracked.world_from_body)
        return False

    def _settle(self, frame: RigFrame, tracked: RigTracked) -> None:
        """Make the first map anew: that before had images of different times as if at rest."""
        self._unsettled -= 1
        self._apply()
        self._map.clear()
        tied, pose = tracked.body_from_views, tracked.world_from_body
        keyframe = self._mapper.add_first_instant(frame, pose, tied, self._recovery.segment)
        self._mapper.extend(frame)
        if len(self._map) < self._config.start.min_points:
            self._recovery.state = State.STARTING
            return
        self._trajectory.add_keyframe(keyframe)
        self._tracker.last = LastRigFrame(frame, self._mapper.as_tracked(tied))

    def _add_keyframe(self, result: FrameResult) -> Keyframe:
        assert self._newest_rig is not None
        frame, tracked = self._newest_rig
        assert tracked is not None
        frame.start_features()
        keyframe = self._mapper.add_instant(frame, tracked, self._recovery.segment)
        self._trajectory.add_keyframe(keyframe)
        self._apply()
        self._window.submit(calibration_weight=self._extrinsics.next_weight())
        self._mapper.extend(frame)
        return keyframe

    def _give_up(self) -> None:
        """Give up the map, before a new segment."""
        self._apply()
        self._note_metre()
        self._map.clear()
        self._tracker.last = None
        self._tracker.motion.give_up()

    @timed("start")
    def _start(self, frame: RigFrame) -> tuple[RigTracked | Failure, Keyframe | None]:
        """A map from the views of one frame that overlap, or from two frames of one camera."""
        needed, pose = self._config.start.min_points, self._tracker.motion.last
        tied, segment = self._set_metre(is_known=True), self._recovery.segment
        self._mapper.add_first_instant(frame, pose, tied, segment)
        self._mapper.extend(frame)
        found = len(self._map)
        if found < needed:
            self._map.discard()
            if self._overlapping:
                return Failure(FailureReason.FEW_LANDMARKS, found, needed), None
            failure = self._start_by_motion(frame, pose)
            if failure is not None:
                return failure, None
        keyframe = self._mapper.newest[0]
        tracked = self._mapper.as_tracked(self._tracker.body_from_views)
        self._recovery.found()
        self._starter.restart()
        self._tracker.restart(frame, tracked, is_metric=self.metre.is_known)
        self._trajectory.add_keyframe(keyframe)
        self._unsettled = _SETTLING if any(frame.delay_s) else 0
        if not self.metre.is_known:
            self._window.submit()
            self._apply()
        return tracked, keyframe

    def _start_by_motion(self, frame: RigFrame, pose: Floats) -> Failure | None:
        """A map from two frames, in which the length of a metre is unknown."""
        pair = self._starter.attempt(frame, self._tracker.body_from_views)
        if isinstance(pair, Failure):
            return pair
        tied, segment = self._set_metre(is_known=False), self._recovery.segment
        self.scale_sources = (self,) if self._extrinsics.body_from_views[:, :3, 3].any() else ()
        first = self._mapper.add_first_instant(pair.first, pose, tied, segment)
        self._mapper.add_first_instant(frame, pose @ pair.motion, tied, segment)
        self._mapper.newest[0].covariance = None
        self._mapper.extend(frame, depth=1.0)
        needed = self._config.start.min_points
        if len(self._map) < needed:
            found = len(self._map)
            self._map.discard()
            return Failure(FailureReason.FEW_LANDMARKS, found, needed)
        self._trajectory.add_keyframe(first)
        for n, each in enumerate(pair.between, 1):
            guess = interpolate(pose, pose @ pair.motion, n / (len(pair.between) + 1))
            tracked = self._tracker.refine(each, guess)
            if tracked is not None:
                self._trajectory.add_frame(each.views[0], first, tracked.world_from_body)
        return None

    def _set_metre(self, *, is_known: bool) -> Floats:
        """Begin with a known or an unknown metre; the views (V, 4, 4) on the body."""
        self.metre.restart(is_known=is_known)
        self._trajectory.store.metric.by_cameras = is_known
        self._place_views()
        return self._tracker.body_from_views

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
        segment = self._recovery.segment
        self._metres[segment] = MetricScale(segment, value, sigma, "turns of the rig")

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
        assert self._newest_rig is not None
        estimate, (_, tracked) = super()._estimate(), self._newest_rig
        seen = () if tracked is None else tracked.views
        matches = sum(len(view.observed) for view in seen)
        return replace(
            estimate,
            features=max(matches, estimate.features),
            matches=matches,
            inliers=sum(view.inliers for view in seen),
        )
