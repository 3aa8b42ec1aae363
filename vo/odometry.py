"""Visual odometry: frame by frame from images to the camera's pose.

The map holds the newest keyframes and the landmarks that they see. Each frame is placed against
it; frames that see too little of it, or see it from a new side, become keyframes, add landmarks
and are smoothed together with the keyframes before them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from subprocess import Popen
from typing import NamedTuple

import cv2
import numpy as np

from vo.backend.calibration_residual import CalibrationResidual
from vo.backend.optimizer import make_optimizer
from vo.backend.sliding_window import Window, cull, make_window, take_in
from vo.backend.solution import WindowSolution
from vo.config import Config
from vo.cores import available_cores
from vo.frontend.exposure import image_defect
from vo.frontend.lazy_future import LazyFuture
from vo.frontend.preprocessing import FramePreprocessor, PreprocessedFrame
from vo.geometry.k1_error import edge_shift_px
from vo.geometry.rectification import rectified_rig
from vo.geometry.right_camera_error import right_camera_error
from vo.geometry.transforms import adjoint, inverse
from vo.geometry.vertical_disparity_model import VerticalDisparity
from vo.mapping.keyframes import add_keyframe, add_tracked, change_since
from vo.mapping.local_map import Keyframe, Map
from vo.mapping.triangulate_mono import triangulate_between_keyframes
from vo.mapping.triangulate_stereo import (
    estimate_normals,
    look_back,
    looks_swapped,
    triangulate_stereo,
)
from vo.refinement.disparity_bias import DisparityBiasEstimator, is_from_yaw
from vo.refinement.radial_distortion import RadialDistortionEstimator
from vo.snapshot import (
    LastFrame,
    landmarks_of,
    make_view,
    neighbours_of,
    points_of,
    with_matches,
)
from vo.stopwatch import Stopwatch
from vo.tracking.essential_matrix import essential_matrix_fallback
from vo.tracking.keyframe_forecast import KeyframeForecast
from vo.tracking.keyframe_policy import needs_keyframe
from vo.tracking.monocular_initializer import MonocularInitializer, map_from_pair
from vo.tracking.motion_model import ConstantVelocity
from vo.tracking.sparse_image_alignment import sparse_image_alignment
from vo.tracking.tracker import (
    TrackedFrame,
    as_tracked_frame,
    refine,
    relocalize,
    track_by_projection,
)
from vo.trajectory.store import TrajectoryStore
from vo.types import (
    Estimate,
    Floats,
    Frame,
    KeyframePose,
    Landmarks,
    LensError,
    Rig,
    RightCameraError,
    State,
)
from vo.warmup import warm_up

# Frames after which the smoother's answer is taken in, unless a keyframe comes before: always the
# same, so that the path does not depend on how fast the smoother is. A stereo map can do without
# it for longer: in mono the landmarks' depth hangs on the poses.
_ANSWER_AFTER_STEREO, _ANSWER_AFTER_MONO = 2, 1
# Windows share most of their keyframes with those before: of the first of a run each is asked what
# the calibration leaves, later one of so many for all of them.
_ALL_ASKED, _SPEAKS_FOR = 10, 3
# Share of the last frame's landmarks that must agree for a pose to be taken without descriptors.
_CLEAR = 0.5
_MEDIAN_DEPTH = 1.0  # of a first mono map, whose scale is free, in every segment anew


class FirstPose(NamedTuple):
    """A pose to begin with, and how many landmarks must agree with what it leads to."""

    pose: Floats
    enough: float = 0.0


class Odometry:
    """Turns frames into poses, one `step` a frame; `close` it at the end.

    How many threads there are, and how fast, makes no difference to any pose.

    Attributes:
        history: the path so far.
        details: whether estimates also have what only recordings show: matches of the view,
            uncertainty and sightings of landmarks, neighbours. It takes a twentieth of the time.

    Args:
        rig: the cameras, as recorded.
        config: all settings.
        smoother_process: that of the smoother (`vo.backend.launch`), if it was started already.
    """

    def __init__(
        self, rig: Rig, config: Config, smoother_process: Popen[bytes] | None = None
    ) -> None:
        warm_up(Odometry)
        cv2.setRNGSeed(config.seed)
        self.history = TrajectoryStore()
        self.details = True
        self._config = config
        self._rig = rectified_rig(rig)
        # Depth cameras have other errors than a wrong rectification.
        self._corrects_disparities = config.stereo.offset_correction and not rig.has_depth
        self._disparity_watch = DisparityBiasEstimator(self._rig)
        self._lens_watch = RadialDistortionEstimator(self._rig)
        threads = config.threads or available_cores()
        self._smoother = make_optimizer(config.smoothing, threads, smoother_process)
        self._preparation = FramePreprocessor(config, threads=threads)
        capacity = config.smoothing.window + config.smoothing.fixed
        self._map = Map(capacity, self._rig.height, self._rig.width)
        self._motion = ConstantVelocity()
        self._mono_start = MonocularInitializer(config)
        self._rows: VerticalDisparity | None = None  # of the right camera, if a pair has told
        self._corrected = VerticalDisparity()  # what of that is corrected in right images
        self._state = State.STARTING
        self._segment = 0
        self._lost: list[PreprocessedFrame] = []  # the newest frames, since the map was lost
        self._last: LastFrame | None = None
        self._window: Window | None = None  # that the smoother works on
        self._windows = 0  # handed in so far
        self._answer_after = _ANSWER_AFTER_STEREO if rig.is_metric else _ANSWER_AFTER_MONO
        self._frames_since_asked = 0
        self._keyframes = config.keyframes if rig.is_metric else config.keyframes.in_mono()
        self._forecast = KeyframeForecast(self._keyframes)
        self._features_soon = True  # whether the next frame's features are likely to be needed
        self._moved: set[int] = set()  # keyframes that were smoothed in this step

    @property
    def disparity_offset_px(self) -> float:
        """The constant error of disparities that is corrected, 0 if none was found."""
        return self._rig.disparity_offset_px

    @property
    def disparity_curve_px(self) -> float:
        """What of it grows with the square of x: pixels at one focal length from the middle."""
        return self._rig.disparity_curve_px

    @property
    def lens_error(self) -> LensError | None:
        """What was wrong with a single camera's lens and is corrected."""
        k1 = self._rig.k1_error
        return LensError(k1, edge_shift_px(self._rig, k1)) if k1 != 0.0 else None

    @property
    def right_camera(self) -> RightCameraError | None:
        """What was wrong with the right camera's calibration and is corrected."""
        return right_camera_error(self._corrected, self._rig)

    def step(self, frame: Frame) -> Estimate:
        """Take in the next frame."""
        return self._step(self._preparation.later(frame, self._rig))

    def steps(self, frames: Iterable[Frame]) -> Iterator[Estimate]:
        """`step` after `step`, each frame read and made ready while the one before is tracked."""
        for coming in self._preparation.ahead(frames, self._rig):
            yield self._step(coming)

    def _step(self, coming: LazyFuture[PreprocessedFrame]) -> Estimate:
        clock = Stopwatch()
        with clock.stage("features"):
            working = coming.result()
            self._rows = working.rows
            if self._features_soon or self._state is not State.TRACKING:
                working.begin_features()
        if working.corrected != self._corrected:
            self._realign(working.corrected, clock)
        reason, tracked, keyframe = self._advance(working, clock)
        is_tracking = self._state is State.TRACKING
        self._preparation.begins_features = self._forecast.expects_all or not is_tracking
        return self._estimate(working, tracked, keyframe, reason, clock)

    def _advance(
        self, frame: PreprocessedFrame, clock: Stopwatch
    ) -> tuple[str, TrackedFrame | None, Keyframe | None]:
        """Place a frame, in a map of its own if need be: why it failed, what it sees, keyframe."""
        self._frames_since_asked += 1
        step = self._look(frame, clock)  # while the smoother works
        if self._frames_since_asked > self._answer_after:
            self._take_in(clock)
        if self._state is State.STARTING:
            return self._start(frame, clock)
        tracked = self._track(frame, step, clock)
        if tracked is not None:
            return "", tracked, self._extend(frame, tracked, clock)
        self._state = State.LOST
        self._lost.append(frame)
        if len(self._lost) <= self._config.tracking.recover_frames:
            return "too few landmarks agree on a pose", None, None
        self._give_up(clock)
        return self._advance(frame, clock)

    def finish(self) -> Mapping[str, float]:
        """Wait for the smoother's last answer, after the last frame; gives `stage_ms` of it."""
        clock = Stopwatch()
        self._take_in(clock)
        return clock.stage_ms

    def close(self) -> None:
        """Let go of threads and processes; no frame can follow."""
        self._smoother.close()
        self._preparation.close()

    # --- placing a frame in the map ---------------------------------------------------------

    def _look(self, frame: PreprocessedFrame, clock: Stopwatch) -> Floats | None:
        """last_from_cam by how the last frame looked, whatever smoothing makes of its pose."""
        if self._last is None or self._state is not State.TRACKING:
            return None
        predicted = self._motion.predict(frame.stamp_ns)
        with clock.stage("match"):
            return sparse_image_alignment(
                self._map, self._last, self._motion.last, frame, predicted, self._rig
            )

    def _track(
        self, frame: PreprocessedFrame, step: Floats | None, clock: Stopwatch
    ) -> TrackedFrame | None:
        """Each first pose is tried until patches confirm one."""
        poses, best = self._first_poses(frame, step), None
        while True:
            with clock.stage("match"):
                first = next(poses, None)
            if first is None:
                return best
            with clock.stage("align"):
                tracked = refine(self._map, frame, first.pose, self._rig, self._config)
            if tracked is None or (best is not None and tracked.inliers < best.inliers):
                tracked = best
            if tracked is not None and tracked.inliers >= first.enough:
                return tracked
            best = tracked

    def _first_poses(self, frame: PreprocessedFrame, step: Floats | None) -> Iterator[FirstPose]:
        """By how the last frame looked; by descriptors, near the prediction and farther away.

        The prediction as it is comes between these; mono's last resort are two views.
        """
        world, rig, config = self._map, self._rig, self._config
        if self._last is not None and step is not None:
            looked = self._motion.last @ step
            yield FirstPose(looked, enough=_CLEAR * int(self._last.inlier.sum()))
        predicted = self._motion.predict(frame.stamp_ns)
        near = track_by_projection(world, frame, predicted, rig, config)
        if near is not None:
            yield FirstPose(near)
        if self._state is State.TRACKING:
            yield FirstPose(predicted)
        else:  # it may have stopped as well as gone on
            near = track_by_projection(world, frame, self._motion.last, rig, config, lost=True)
            if near is not None:
                yield FirstPose(near)
        anywhere = relocalize(world, frame, rig, config)
        if anywhere is not None:
            yield FirstPose(anywhere)
        if not rig.is_stereo and self._last is not None:
            step = essential_matrix_fallback(
                world, self._last, self._motion.last, frame, rig, config
            )
            if step is not None:
                yield FirstPose(step)

    # --- extending the map ------------------------------------------------------------------

    def _extend(
        self, frame: PreprocessedFrame, tracked: TrackedFrame, clock: Stopwatch
    ) -> Keyframe | None:
        """Take in a tracked frame; make it a keyframe if the map needs one."""
        self._state, self._lost = State.TRACKING, []
        self._motion.update(frame.stamp_ns, tracked.world_from_cam)
        change = change_since(self._map, frame, tracked, self._config)
        is_keyframe = needs_keyframe(change, self._keyframes)
        self._features_soon = self._forecast.expects(change, is_keyframe=is_keyframe)
        if not is_keyframe:
            newest = self._map.keyframes[-1]
            pose = self._cam0(tracked.world_from_cam)
            self.history.add(frame.index, frame.stamp_ns, self._segment, newest.id, pose)
            return None
        frame.begin_features()
        with clock.stage("map"):
            keyframe = add_tracked(
                self._map, frame, tracked, self._segment, self._rig, self._config
            )
        if self._rig.is_stereo:  # the smoother works while the map grows
            self._smooth(keyframe, clock)
        with clock.stage("map"):
            self._grow(keyframe, frame)
        if not self._rig.is_stereo:  # mono's new landmarks need smoothing before they are used
            self._smooth(keyframe, clock)
        return keyframe

    def _grow(self, keyframe: Keyframe, frame: PreprocessedFrame) -> None:
        if frame.has_disparity:
            triangulate_stereo(self._map, keyframe, frame, self._rig, self._config)
        else:
            triangulate_between_keyframes(
                self._map, keyframe, frame.image0, self._rig, self._config
            )
        estimate_normals(self._map, keyframe, self._rig, only_new=True)
        look_back(self._map, keyframe, self._rig, self._config)

    # --- smoothing --------------------------------------------------------------------------

    def _smooth(self, keyframe: Keyframe, clock: Stopwatch) -> None:
        """Hang a new keyframe's frame on it, and have the window that ends with it adjusted."""
        self._store([keyframe])
        self._hang(keyframe)
        self._take_in(clock)
        with clock.stage("window"):
            self._ask()

    def _ask(self, *, whole_map: bool = False) -> None:
        speaks_for = 0 if whole_map else self._windows_spoken_for()
        window = make_window(
            self._map, self._rig, self._config, whole_map=whole_map, speaks_for=speaks_for
        )
        if window is not None:
            self._smoother.ask(window.problem)
            self._windows += not whole_map
        self._window, self._frames_since_asked = window, 0

    def _windows_spoken_for(self) -> int:
        """For how many windows the next one tells what the calibration leaves."""
        is_stereo, lens = self._rig.is_stereo, self._config.tracking.lens_correction
        if not (self._corrects_disparities if is_stereo else lens):
            return 0
        if self._windows < _ALL_ASKED:
            return 1
        return _SPEAKS_FOR if self._windows % _SPEAKS_FOR == 0 else 0

    def _take_in(self, clock: Stopwatch) -> None:
        """Wait for the smoother's answer, if there is to be one, and bring the map in line."""
        if self._window is None:
            return
        newest, before = self._window.keyframes[-1], self._window.problem.world_from_cam[-1]
        speaks_for = self._window.speaks_for
        with clock.stage("smooth"):
            solution = self._smoother.answer()
        with clock.stage("window"):
            self._settle(solution)
            if solution.left is not None:
                self._watch_calibration(solution.left, speaks_for)
            cull(self._map, self._config)
            estimate_normals(self._map, self._map.keyframes[-1], self._rig)
        self._motion.carry(newest.world_from_cam @ inverse(before))

    def _settle(self, solution: WindowSolution) -> None:
        assert self._window is not None
        moved = take_in(self._map, self._window, solution, self._rig, self._config)
        self._window = None
        self._store(moved)
        self._moved.update(k.id for k in moved)

    def _watch_calibration(self, left: CalibrationResidual, windows: int) -> None:
        """Move the map, and all that follows, to what the calibration should be, once sure."""
        if self._rig.is_stereo:
            error = self._disparity_watch.update(left, windows)
            if error is not None:
                self._correct_disparities(*error.tolist())
                self._smooth_map()
        else:
            k1 = self._lens_watch.update(left, windows)
            if k1 is not None:
                self._rig = self._rig.with_k1_error(k1)
                for keyframe in self._map.keyframes:
                    keyframe.see_through(self._rig)
                self._smooth_map()

    def _correct_disparities(self, offset_px: float, curve_px: float) -> None:
        """Move all disparities, past and future, to a new offset and curve."""
        before = self._rig
        self._rig = replace(
            before,
            disparity_offset_px=offset_px,
            disparity_curve_px=curve_px,
            offset_is_yaw=self._rows is not None and is_from_yaw(offset_px, self._rows.skew_px),
        )
        for keyframe in self._map.keyframes:
            right_u = keyframe.image_xy[:, 0] - keyframe.disparity
            change = self._rig.disparity_error(right_u) - before.disparity_error(right_u)
            keyframe.disparity -= change

    def _realign(self, corrected: VerticalDisparity, clock: Stopwatch) -> None:
        """Move the disparities of the past to where a better alignment would have seen them."""
        self._take_in(clock)
        before, self._corrected = self._corrected, corrected
        rig = self._rig
        for keyframe in self._map.keyframes:
            x = (keyframe.image_xy[:, 0] - keyframe.disparity - rig.cx) / rig.fx
            y = (keyframe.image_xy[:, 1] - rig.cy) / rig.fy
            keyframe.disparity += corrected.horizontal_px(x, y) - before.horizontal_px(x, y)
        with clock.stage("window"):
            self._smooth_map()

    def _smooth_map(self) -> None:
        self._ask(whole_map=True)
        if self._window is not None:
            self._settle(self._smoother.answer())

    # --- beginning and losing ---------------------------------------------------------------

    def _start(
        self, frame: PreprocessedFrame, clock: Stopwatch
    ) -> tuple[str, TrackedFrame | None, Keyframe | None]:
        with clock.stage("start"):
            started = self._start_stereo(frame) if self._rig.is_stereo else self._start_mono(frame)
        if isinstance(started, str):
            return started, None, None
        self._state, self._lost = State.TRACKING, []
        self._motion.restart(started.stamp_ns, started.world_from_cam)
        self._smooth(started, clock)
        return "", as_tracked_frame(self._map, started), started

    def _start_stereo(self, frame: PreprocessedFrame) -> Keyframe | str:
        if not frame.has_disparity:
            return "the right image, or depth, is missing"
        self._map.clear()
        everything = np.ones(len(frame.keypoints), dtype=bool)
        anchor = self._motion.last
        keyframe = add_keyframe(self._map, frame, anchor, self._segment, everything, self._rig)
        keyframe.covariance = np.zeros((6, 6))  # what comes later is measured against it
        count = triangulate_stereo(self._map, keyframe, frame, self._rig, self._config)
        if count >= self._config.start.min_points:
            return keyframe
        self._map.clear()
        if looks_swapped(frame, self._rig, self._config):
            return "disparities are negative: left and right images seem to be swapped"
        needed = self._config.start.min_points
        return f"{count} landmarks with a depth, {needed} needed"

    def _start_mono(self, frame: PreprocessedFrame) -> Keyframe | str:
        pair = self._mono_start.attempt(frame, self._rig)
        if isinstance(pair, str):
            return pair
        self._map.clear()
        sigma_px = self._config.tracking.sigma_px
        first, second = map_from_pair(
            self._map, pair, self._motion.last, _MEDIAN_DEPTH, self._segment, self._rig, sigma_px
        )
        self._store([first])
        self._hang(first)
        self._ask()
        self._settle(self._smoother.answer())
        for waiting in self._mono_start.waiting:
            self._place(waiting, first)
        self._mono_start.restart()
        return second

    def _place(self, frame: PreprocessedFrame, first: Keyframe) -> None:
        """Give a frame that waited for the first map its pose in it, if it has one there."""
        pose = relocalize(self._map, frame, self._rig, self._config)
        tracked = None if pose is None else refine(self._map, frame, pose, self._rig, self._config)
        if tracked is not None:
            in_world = self._cam0(tracked.world_from_cam)
            self.history.add(frame.index, frame.stamp_ns, self._segment, first.id, in_world)

    def _give_up(self, clock: Stopwatch) -> None:
        """Leave the old map; the frames that were lost get their chance in a new one."""
        self._take_in(clock)
        *lost, _ = self._lost
        self._lost, self._last = [], None
        self._state = State.STARTING
        self._segment += 1
        self._mono_start.restart()
        for frame in lost:
            _, tracked, keyframe = self._advance(frame, clock)
            self._remember(frame, tracked, keyframe)

    def _remember(
        self, frame: PreprocessedFrame, tracked: TrackedFrame | None, keyframe: Keyframe | None
    ) -> None:
        """Keep what the next frame needs of this one, and what the next estimate has to tell."""
        if tracked is not None:
            image_xy = tracked.observed.image_xy
            self._last = LastFrame(frame, tracked.ids, image_xy, tracked.inlier)
        if keyframe is not None:
            self._moved.add(keyframe.id)

    # --- keeping the books ------------------------------------------------------------------

    def _hang(self, keyframe: Keyframe) -> None:
        """Enter a keyframe's own frame into the path."""
        pose = self._cam0(keyframe.world_from_cam)
        index, stamp_ns = keyframe.frame_index, keyframe.stamp_ns
        self.history.add(index, stamp_ns, keyframe.segment, keyframe.id, pose)

    def _store(self, keyframes: Sequence[Keyframe]) -> None:
        """Enter keyframes into the path, or what has become of them."""
        if not keyframes:
            return
        poses = self._cam0(np.stack([k.world_from_cam for k in keyframes]))
        turn = adjoint(self._rig.cam0_from_rectified)
        for keyframe, pose in zip(keyframes, poses, strict=True):
            covariance = keyframe.covariance
            if covariance is not None:
                covariance = turn @ covariance @ turn.T
            place = keyframe.frame_index, keyframe.stamp_ns, keyframe.segment
            self.history.store(keyframe.id, KeyframePose(*place, pose, covariance))

    def _cam0(self, world_from_rectified: Floats) -> Floats:
        """The same poses (..., 4, 4) for the recorded cam0, in a world that is cam0 at first."""
        turn = self._rig.cam0_from_rectified
        return np.asarray(turn @ world_from_rectified @ inverse(turn))

    def _estimate(
        self,
        frame: PreprocessedFrame,
        tracked: TrackedFrame | None,
        keyframe: Keyframe | None,
        reason: str,
        clock: Stopwatch,
    ) -> Estimate:
        pose = None
        if tracked is not None:
            # A keyframe may have been carried along by the answer to the window before it.
            pose = tracked.world_from_cam if keyframe is None else keyframe.world_from_cam
        view = make_view(frame, tracked, self._rig)
        if self.details:
            view = with_matches(view, tracked, self._last, self._rig, self._map, pose)
        self._remember(frame, tracked, keyframe)
        moved, self._moved = sorted(self._moved), set()
        return Estimate(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            state=self._state,
            reason=reason if tracked is not None else image_defect(frame) or reason,
            segment=self._segment,
            world_from_cam0=None if pose is None else self._cam0(pose),
            is_keyframe=keyframe is not None,
            matches=0 if tracked is None else len(tracked.observed),
            inliers=0 if tracked is None else tracked.inliers,
            median_disparity_px=None if tracked is None else tracked.median_disparity_px,
            keyframes=tuple(self.history.keyframes_by_id(moved)),
            view=view,
            landmarks=self._landmarks() if moved else None,
            stage_ms=clock.stage_ms,
            neighbours=neighbours_of(self._map, keyframe) if keyframe and self.details else {},
            disparity_offset_px=self.disparity_offset_px,
        )

    def _landmarks(self) -> Landmarks:
        if not self.details:
            return points_of(self._map, self._rig)
        sigma_disparity_px = self._config.smoothing.sigma_disparity_px
        return landmarks_of(self._map, self._rig, sigma_disparity_px)
