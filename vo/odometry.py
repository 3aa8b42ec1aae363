"""Visual odometry: frame by frame from images to the camera's pose.

The map holds the newest keyframes and the landmarks that they see. Each frame is placed against
it; frames that see too little of it, or see it from a new side, become keyframes, add landmarks
and are smoothed together with the keyframes before them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from vo.config import Config
from vo.features.orb import OrbDetector
from vo.geometry.rectification import working_rig
from vo.geometry.transforms import adjoint, inverse, transform_points
from vo.mapping.map import Keyframe, Map
from vo.pipeline import observe
from vo.pipeline.adjust import adjust, cull
from vo.pipeline.disparity_watch import DisparityWatch
from vo.pipeline.essential_step import essential_step
from vo.pipeline.grow import far_from, grow_mono, grow_stereo, look_back
from vo.pipeline.history import History
from vo.pipeline.observe import Observed
from vo.pipeline.start import MonoStart, add_keyframe, map_from_pair
from vo.pipeline.stopwatch import Stopwatch
from vo.pipeline.working_frame import WorkingFrame, prepare
from vo.tracking.keyframes import median_parallax, needs_keyframe
from vo.tracking.motion import ConstantVelocity
from vo.types import (
    Bools,
    Estimate,
    FeatureState,
    Floats,
    Floats32,
    Frame,
    Ints,
    KeyframePose,
    Landmarks,
    Rig,
    State,
    View,
)


@dataclass(frozen=True, eq=False)
class Tracked:
    """A frame placed in the map: its pose, what it sees (landmark ids), and what agrees."""

    world_from_cam: Floats
    ids: Ints
    observed: Observed
    inlier: Bools


_PATCH_SCALE = 1.3  # patches of landmarks that have changed size by more are taken anew
_PATCH_SCORE = 0.9  # and those that correlate less


class Odometry:
    """Turns frames into poses, one `step` a frame."""

    def __init__(self, rig: Rig, config: Config) -> None:
        cv2.setRNGSeed(config.seed)
        self.history = History()
        self._config = config
        self._rig = working_rig(rig)
        self._detector = OrbDetector(config.features)
        capacity = config.smoothing.window + config.smoothing.fixed
        self._map = Map(capacity, self._rig.height, self._rig.width)
        self._motion = ConstantVelocity()
        self._mono_start = MonoStart(self._rig, config)
        self._disparity_watch = DisparityWatch()
        self._state = State.STARTING
        self._segment = 0
        self._lost_for = 0
        self._median_depth = 1.0  # of a mono map, whose scale is free
        self._last: tuple[WorkingFrame, Ints, Floats] | None = None  # frame, landmarks, pixels

    @property
    def disparity_offset_px(self) -> float:
        """The constant error of disparities that is corrected, 0 if none was found."""
        return self._rig.disparity_offset_px

    def step(self, frame: Frame) -> Estimate:
        """Take in the next frame."""
        clock = Stopwatch()
        with clock.stage("features"):
            working = prepare(frame, self._rig, self._detector)
        reason, tracked = "", None
        smoothed: list[Keyframe] = []
        if self._state is not State.STARTING:
            tracked = self._track(working, clock)
            if tracked is None:
                reason = self._lose()
        if self._state is State.STARTING:
            reason, tracked, smoothed = self._start(working, clock)
        elif tracked is not None:
            smoothed = self._extend(working, tracked, clock)
        return self._estimate(working, tracked, smoothed, reason, clock)

    # --- placing a frame in the map ---------------------------------------------------------

    def _track(self, frame: WorkingFrame, clock: Stopwatch) -> Tracked | None:
        with clock.stage("match"):
            pose = self._first_pose(frame)
        if pose is None:
            return None
        with clock.stage("align"):
            tracked = self._refined(frame, pose)
        if int(tracked.inlier.sum()) < self._config.tracking.min_inliers:
            return None
        return tracked

    def _first_pose(self, frame: WorkingFrame) -> Floats | None:
        """A pose from descriptors: near the prediction, else farther away, else anywhere."""
        predicted = self._motion.predict(frame.stamp_ns)
        radius = self._config.tracking.search_share * self._rig.width
        if self._state is State.TRACKING:
            for widen in (1.0, 3.0):
                pose = self._pose_near(frame, predicted, widen * radius)
                if pose is not None:
                    return pose
        rows, keypoints = observe.match_without_prediction(self._map, frame, self._config.tracking)
        pose = self._pose_of(frame, rows, keypoints)
        if pose is None and not self._rig.is_stereo and self._last is not None:
            last, ids, xy = self._last
            pose = essential_step(
                self._map, last, self._motion.last, ids, xy, frame, self._rig, self._config
            )
        return pose

    def _pose_near(self, frame: WorkingFrame, predicted: Floats, radius_px: float) -> Floats | None:
        visible = observe.visible_landmarks(self._map, self._rig, predicted)
        factor = self._config.features.scale_factor
        query, keypoints = observe.match_by_descriptor(
            self._map, visible, frame, radius_px, factor, self._config.tracking
        )
        return self._pose_of(frame, visible.rows[query], keypoints)

    def _pose_of(self, frame: WorkingFrame, rows: Ints, keypoints: Ints) -> Floats | None:
        factor = self._config.features.scale_factor
        found = observe.pose_from_matches(
            self._map.xyz[rows],
            frame.ideal_xy[keypoints],
            factor ** frame.keypoints.octave[keypoints].astype(np.float64),
            self._rig,
            self._config.tracking,
        )
        return None if found is None else found[0]

    def _refined(self, frame: WorkingFrame, pose: Floats) -> Tracked:
        """Align every landmark in view, starting from the first pose, and fit the pose to them."""
        config = self._config.tracking
        visible = observe.visible_landmarks(self._map, self._rig, pose)
        visible = observe.most_promising(self._map, visible, config.max_landmarks)
        observed = observe.align_landmarks(
            self._map, visible, pose, frame.image0, self._rig, config
        )
        observed = observe.with_disparity(
            observed, self._map, pose, frame, self._rig, config, self._config.stereo
        )
        fit = observe.fit_pose(self._map, observed, pose, self._rig, config)
        self._map.visible[visible.rows] += 1
        self._map.found[observed.rows[fit.inlier]] += 1
        ids = self._map.id[observed.rows]
        return Tracked(inverse(fit.cam_from_world), ids, observed, fit.inlier)

    # --- extending the map ------------------------------------------------------------------

    def _extend(self, frame: WorkingFrame, tracked: Tracked, clock: Stopwatch) -> list[Keyframe]:
        """Take in a tracked frame; make it a keyframe if the map needs one."""
        self._state, self._lost_for = State.TRACKING, 0
        self._motion.update(frame.stamp_ns, tracked.world_from_cam)
        if not self._needs_keyframe(frame, tracked):
            self._note(frame, tracked.world_from_cam)
            return []
        with clock.stage("map"):
            keyframe = self._add_keyframe(frame, tracked)
            self._grow(keyframe, frame)
        return self._smooth(keyframe, clock)

    def _needs_keyframe(self, frame: WorkingFrame, tracked: Tracked) -> bool:
        last = self._map.keyframes[-1]
        inliers = tracked.observed.rows[tracked.inlier]
        parallax = median_parallax(
            self._map.xyz[inliers], last.world_from_cam[:3, 3], tracked.world_from_cam[:3, 3]
        )
        share = len(inliers) / max(len(last.landmark), 1)
        elapsed_s = (frame.stamp_ns - last.stamp_ns) * 1e-9
        return needs_keyframe(share, parallax, elapsed_s, self._config.keyframes)

    def _add_keyframe(self, frame: WorkingFrame, tracked: Tracked) -> Keyframe:
        # From here on only ids hold: rows move when the oldest keyframe goes.
        ids, observed, inlier = tracked.ids, tracked.observed, tracked.inlier
        free = far_from(frame.keypoints.xy.astype(np.float64), observed.image_xy)
        keyframe = add_keyframe(self._map, frame, tracked.world_from_cam, self._segment, free)
        inlier = inlier & (self._map.rows(ids) >= 0)
        keyframe.add_observations(
            ids[inlier],
            observed.xy[inlier],
            observed.image_xy[inlier],
            observed.disparity[inlier],
            observed.sigma_px[inlier],
        )
        rows = self._map.rows(ids[inlier])
        self._map.last_seen[rows] = keyframe.id
        self._renew_patches(keyframe, rows, observed.scale[inlier], observed.score[inlier])
        return keyframe

    def _renew_patches(self, keyframe: Keyframe, rows: Ints, scale: Floats, score: Floats) -> None:
        """Take patches from this keyframe where the old ones have become too different."""
        stale = (np.abs(np.log(scale)) > np.log(_PATCH_SCALE)) | (score < _PATCH_SCORE)
        factor = self._config.features.scale_factor
        octave = observe.predicted_octave(self._map.octave[rows], scale, factor)
        self._map.octave[rows[stale]] = octave[stale]
        mask = np.zeros(len(self._map), dtype=bool)
        mask[rows[stale]] = True
        self._map.take_reference(keyframe, mask)

    def _grow(self, keyframe: Keyframe, frame: WorkingFrame) -> None:
        if self._rig.is_stereo:
            grow_stereo(self._map, keyframe, frame, self._rig, self._detector, self._config)
        else:
            grow_mono(self._map, keyframe, frame.image0, self._rig, self._config)
        look_back(self._map, keyframe, self._rig, self._config)

    def _smooth(self, keyframe: Keyframe, clock: Stopwatch) -> list[Keyframe]:
        """Adjust the window that ends with this keyframe, and hang the frame on it."""
        self._store(keyframe)
        self._hang(keyframe)
        with clock.stage("smooth"):
            smoothed, left_over = adjust(self._map, self._rig, self._config)
            offset = None if left_over is None else self._disparity_watch.update(left_over)
            if offset is not None:
                smoothed = self._correct_disparities(offset)
            cull(self._map, self._config)
        for other in smoothed:
            self._store(other)
        self._motion.correct(keyframe.world_from_cam)
        return smoothed or [keyframe]

    def _correct_disparities(self, offset_px: float) -> list[Keyframe]:
        """Move all disparities, past and future, to a new offset, and the map with them."""
        change = offset_px - self._rig.disparity_offset_px
        self._rig = replace(self._rig, disparity_offset_px=offset_px)
        for keyframe in self._map.keyframes:
            keyframe.disparity -= change
        return adjust(self._map, self._rig, self._config, whole_map=True)[0]

    # --- beginning and losing ---------------------------------------------------------------

    def _start(
        self, frame: WorkingFrame, clock: Stopwatch
    ) -> tuple[str, Tracked | None, list[Keyframe]]:
        with clock.stage("start"):
            started = self._start_stereo(frame) if self._rig.is_stereo else self._start_mono(frame)
        if isinstance(started, str):
            return started, None, []
        self._state, self._lost_for = State.TRACKING, 0
        self._motion.restart(started.stamp_ns, started.world_from_cam)
        tracked = self._all_of(started)
        return "", tracked, self._smooth(started, clock)

    def _start_stereo(self, frame: WorkingFrame) -> Keyframe | str:
        if frame.image1 is None:
            return "the right image is missing"
        self._map.clear()
        everything = np.ones(len(frame.keypoints), dtype=bool)
        anchor = self._motion.last
        keyframe = add_keyframe(self._map, frame, anchor, self._segment, everything)
        keyframe.covariance = np.zeros((6, 6))  # what comes later is measured against it
        keyframe.covariance = np.zeros((6, 6))  # what comes later is measured against it
        count = grow_stereo(self._map, keyframe, frame, self._rig, self._detector, self._config)
        if count >= self._config.start.min_points:
            return keyframe
        self._map.clear()
        needed = self._config.start.min_points
        return f"{count} landmarks from left and right, {needed} needed"

    def _start_mono(self, frame: WorkingFrame) -> Keyframe | str:
        pair = self._mono_start.attempt(frame)
        if isinstance(pair, str):
            return pair
        self._map.clear()
        sigma_px = self._config.tracking.sigma_px
        first, second = map_from_pair(
            self._map, pair, self._motion.last, self._median_depth, self._segment, sigma_px
        )
        self._store(first)
        self._hang(first)
        adjust(self._map, self._rig, self._config)
        for waiting in self._mono_start.waiting:
            self._place(waiting, first)
        self._mono_start.restart()
        return second

    def _place(self, frame: WorkingFrame, first: Keyframe) -> None:
        """Give a frame that waited for the first map its pose in it, if it has one there."""
        rows, keypoints = observe.match_without_prediction(self._map, frame, self._config.tracking)
        pose = self._pose_of(frame, rows, keypoints)
        if pose is None:
            return
        tracked = self._refined(frame, pose)
        if int(tracked.inlier.sum()) >= self._config.tracking.min_inliers:
            pose = self._cam0(tracked.world_from_cam)
            self.history.add(frame.index, frame.stamp_ns, self._segment, first.id, pose)

    def _lose(self) -> str:
        """Note a frame that could not be placed; give the map up after too many of them."""
        self._state = State.LOST
        self._lost_for += 1
        patience = self._config.tracking.recover_frames
        if self._lost_for > patience:
            self._state = State.STARTING
            self._segment += 1
            self._mono_start.restart()
            self._last = None
            return f"lost for {self._lost_for} frames, a new segment begins"
        return f"fewer than {self._config.tracking.min_inliers} landmarks agree"

    # --- keeping the books ------------------------------------------------------------------

    def _hang(self, keyframe: Keyframe) -> None:
        """Enter a keyframe's own frame into the path."""
        pose = self._cam0(keyframe.world_from_cam)
        index, stamp_ns = keyframe.frame_index, keyframe.stamp_ns
        self.history.add(index, stamp_ns, keyframe.segment, keyframe.id, pose)

    def _note(self, frame: WorkingFrame, world_from_cam: Floats) -> None:
        newest = self._map.keyframes[-1]
        pose = self._cam0(world_from_cam)
        self.history.add(frame.index, frame.stamp_ns, self._segment, newest.id, pose)

    def _store(self, keyframe: Keyframe) -> None:
        covariance = keyframe.covariance
        if covariance is not None:
            turn = adjoint(self._rig.cam0_from_working)
            covariance = turn @ covariance @ turn.T
        self.history.keyframes[keyframe.id] = KeyframePose(
            keyframe.frame_index,
            keyframe.stamp_ns,
            keyframe.segment,
            self._cam0(keyframe.world_from_cam),
            covariance,
        )

    def _cam0(self, world_from_working: Floats) -> Floats:
        """The same pose for the recorded cam0, in a world that is cam0 where it began."""
        turn = self._rig.cam0_from_working
        return np.asarray(turn @ world_from_working @ inverse(turn))

    def _all_of(self, keyframe: Keyframe) -> Tracked:
        """A first keyframe as if it had been tracked."""
        n = len(keyframe.landmark)
        observed = Observed(
            self._map.rows(keyframe.landmark),
            keyframe.image_xy,
            keyframe.xy,
            keyframe.disparity,
            keyframe.sigma_px,
            np.ones(n),
            np.ones(n),
        )
        every = np.ones(n, dtype=bool)
        return Tracked(keyframe.world_from_cam, keyframe.landmark, observed, every)

    def _estimate(
        self,
        frame: WorkingFrame,
        tracked: Tracked | None,
        smoothed: list[Keyframe],
        reason: str,
        clock: Stopwatch,
    ) -> Estimate:
        return Estimate(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            state=self._state,
            reason=reason,
            segment=self._segment,
            world_from_cam0=None if tracked is None else self._cam0(tracked.world_from_cam),
            is_keyframe=bool(smoothed),
            matches=0 if tracked is None else len(tracked.observed),
            inliers=0 if tracked is None else int(tracked.inlier.sum()),
            keyframes=tuple(self.history.keyframes[k.id] for k in smoothed),
            view=self._view(frame, tracked),
            landmarks=self._landmarks() if smoothed else None,
            stage_ms=clock.stage_ms,
        )

    def _view(self, frame: WorkingFrame, tracked: Tracked | None) -> View:
        """Features for display, and memory of where the landmarks were for the next frame."""
        xy, state = frame.keypoints.xy, np.full(len(frame.keypoints), FeatureState.NEW, np.uint8)
        previous = np.full((len(xy), 2), np.nan, np.float32)
        if tracked is not None:
            seen_xy = tracked.observed.image_xy.astype(np.float32)
            free = far_from(xy.astype(np.float64), tracked.observed.image_xy)
            codes = np.where(tracked.inlier, FeatureState.TRACKED, FeatureState.REJECTED)
            before = self._before(tracked.ids)
            xy = np.concatenate([seen_xy, xy[free]])
            state = np.concatenate([codes.astype(np.uint8), state[free]])
            previous = np.concatenate([before, previous[free]])
            self._last = (frame, tracked.ids, tracked.observed.image_xy)
        return View(frame.image0, frame.image1, xy, state, previous, self._rig.matrix)

    def _before(self, ids: Ints) -> Floats32:
        """Pixels (n, 2) of landmarks in the last tracked frame, NaN where they were not seen."""
        result = np.full((len(ids), 2), np.nan, np.float32)
        if self._last is not None and len(self._last[1]):
            _, last_ids, last_xy = self._last
            _, here, there = np.intersect1d(ids, last_ids, return_indices=True)
            result[here] = last_xy[there]
        return result

    def _landmarks(self) -> Landmarks:
        points = transform_points(self._rig.cam0_from_working, self._map.xyz)
        return Landmarks(self._map.id.copy(), points)
