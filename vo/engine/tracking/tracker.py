"""Tracking: the pose of a frame in the map.

An initial pose comes from sparse image alignment, from descriptors near the predicted pose or
anywhere, or from an essential matrix. It is refined on the patches of all landmarks in view.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.config import StartConfig, TrackingConfig
from vo.base.failures import Failure, FailureReason
from vo.base.faults import Fault
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Floats, Ints
from vo.engine.frontend.contracts import Circles, FeatureSet, feature_set
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.octaves import predicted_octave
from vo.engine.mapping.tracked_frame import LastFrame, TrackedFrame, last_frame
from vo.engine.tracking.essential_matrix import EssentialMatrixFallback
from vo.engine.tracking.focal_change import FocalChangeDetector
from vo.engine.tracking.landmark_alignment import KltAligner, LandmarkAligner
from vo.engine.tracking.motion_model import ConstantVelocity, MotionModel, PosePrior
from vo.engine.tracking.pose_estimation import PoseEstimator
from vo.engine.tracking.pose_residuals import pose_residuals
from vo.engine.tracking.rolling_shutter import RollingShutter
from vo.engine.tracking.sparse_image_alignment import sparse_image_alignment
from vo.engine.tracking.step_check import MapAgreement, Step, StepCheck
from vo.engine.tracking.torn_images import TornImageDetector
from vo.engine.tracking.visibility import outside, visible_landmarks

# Radii of the search windows, tried in turn, in units of the configured one.
_RADII = (1.0, 3.0)
_RADII_LOST = (3.0, 8.0)
# Minimum ratio of the last frame's inliers that must agree with a pose from sparse image alignment.
_MIN_SPARSE_RATIO = 0.5
# Minimum ratio of the landmarks in view that confirm the first step of a segment at once. With
# less, something that moves with the camera may be what was found: all other poses are tried.
_MIN_FIRST_RATIO = 0.5
_EXAMINED = 3  # residuals of every third frame are examined


class _InitialPose(NamedTuple):
    """A pose to refine, and the number of inliers from which no other pose is tried."""

    world_from_cam: Floats
    sufficient_inliers: float = 0.0


class Tracker:
    """Tracks frames in the local map; holds the motion model and the last frame.

    Attributes:
        last: the last tracked frame, None before the first of a segment.
        knows_velocity: whether two frames of the segment have been tracked.
        stopwatch: counts stages `match` and `align`.
    """

    def __init__(
        self,
        local_map: LocalMap,
        frontend: Frontend,
        motion: MotionModel,
        config: TrackingConfig,
        start: StartConfig,
        stopwatch: Stopwatch,
    ) -> None:
        self.last: LastFrame | None = None
        self.knows_velocity = False
        self.stopwatch = stopwatch
        self._map = local_map
        self._matcher = frontend.matcher
        self._scale_factor = frontend.scale_factor
        self._motion = motion
        self._shutter = RollingShutter(local_map, motion)
        self._config = config
        aligner = KltAligner if config.method == "klt" else LandmarkAligner
        self._aligner = aligner(local_map, frontend, config.min_inliers)
        self._estimator = PoseEstimator(local_map, frontend.stereo.sigma_disparity_px, config)
        self._steps = StepCheck(is_metric=local_map.rig.is_metric)
        self._agreement = MapAgreement(is_metric=local_map.rig.is_metric)
        self._focal_change = FocalChangeDetector()
        self._torn_images = TornImageDetector(local_map.rig.height)
        self._updates = 0
        self._kept: tuple[LastFrame | None, MotionModel, LocalMap] | None = None
        self._essential_matrix = EssentialMatrixFallback(local_map, frontend.matcher, start)

    @property
    def last_pose(self) -> Floats:
        """world_from_cam of the last tracked frame, the identity before the first."""
        return self._motion.last

    def restart(self, frame: PreprocessedFrame, tracked: TrackedFrame) -> None:
        """Begin at the frame that a new map was made of, with unknown velocity."""
        self._motion.restart(frame.stamp_ns, tracked.world_from_cam)
        self._shutter.restart(frame.stamp_ns)
        self._steps.restart(frame.stamp_ns)
        self._agreement.restart()
        self._focal_change.restart()
        self.last = last_frame(frame, tracked)
        self.knows_velocity = False

    def update(self, frame: PreprocessedFrame, tracked: TrackedFrame) -> tuple[Fault, ...]:
        """Continue from a tracked frame; the faults that it shows."""
        self._steps.update(self._step(frame, tracked))
        self._shutter.update(frame.stamp_ns, tracked.world_from_cam)
        self._motion.update(frame.stamp_ns, tracked.world_from_cam)
        self.last = last_frame(frame, tracked)
        self.knows_velocity = True
        self._updates += 1
        if self._updates % _EXAMINED == 0:
            residuals = pose_residuals(self._map.rig, self._map.xyz, tracked)
            self._focal_change.update(residuals)
            self._torn_images.update(residuals)
        found = self._focal_change.faults + self._torn_images.faults
        return self._agreement.update(tracked) or found

    def restart_at(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Expect a new map, with a camera at this pose (4, 4) of unknown velocity."""
        self._motion.restart(stamp_ns, world_from_cam)
        self._shutter.restart(stamp_ns)
        self.last = None

    def forget_last_frame(self) -> None:
        """Forget the last frame, before a new segment."""
        self.last = None
        self._motion.give_up()

    def move(self, motion: Floats) -> None:
        """Follow the map's newest keyframe, which optimisation has moved by (4, 4)."""
        self._motion.move(motion)

    def motion_px(self, ids: Ints, stamp_ns: int, last_from_cam: Floats | None = None) -> float:
        """Median motion of landmarks in the image from the last frame to a time or a pose, or 0."""
        last, moved = self._motion.last, last_from_cam
        now = self._motion.predict(stamp_ns) if moved is None else last @ moved
        return median_motion_px(self._map, ids, last, now)

    def predicted(self, frame: PreprocessedFrame) -> PosePrior | None:
        """The pose of a frame that was not tracked, by an inertial sensor; None if unknown."""
        return self._motion.of_lost(frame.stamp_ns)

    def ahead(self, stamp_ns: int) -> Floats | PosePrior | None:
        """The pose at a later time than the newest frame; None if it is unknown."""
        return None if self.last is None else self._motion.ahead(stamp_ns)

    def keep_last(self) -> bool:
        """Keep what `align_to_last` uses as it is now; whether the map may change until then."""
        if type(self._motion) is not ConstantVelocity or self._map.rig.readout_s > 0.0:
            return False
        seen = copy(self._map)
        seen.xyz = seen.xyz.copy()
        self._kept = self.last, copy(self._motion), seen
        return True

    def forget_kept(self) -> None:
        """Align to the last frame in the map as it is then."""
        self._kept = None

    @timed("match")
    def align_to_last(self, frame: PreprocessedFrame) -> Floats | None:
        """last_from_cam (4, 4) by sparse image alignment; None if it fails.

        It depends on the landmarks' positions relative to the last frame only, and stays valid when
        optimisation moves both in the world.
        """
        last, motion, seen = self.last, self._motion, self._map
        if last is None:
            return None
        if self._kept is not None and self._kept[0] is last:
            _, motion, seen = self._kept
        predicted = motion.predict(frame.stamp_ns)
        velocity = self._shutter.velocity(frame.stamp_ns, predicted)
        return sparse_image_alignment(seen, last, motion.last, frame, predicted, velocity)

    @timed("match")
    def track(
        self, frame: PreprocessedFrame, last_from_cam: Floats | None, *, is_lost: bool = False
    ) -> TrackedFrame | Failure:
        """The pose of a frame, or why it has none.

        Where the pair gives no pose, the left image alone is tried. A step that the motion before
        does not support is tried again from other initial poses.

        `last_from_cam` (4, 4) is from `align_to_last`.
        """
        tracked = self._confirmed(frame, last_from_cam, is_lost=is_lost)
        if tracked is None and frame.has_disparity and self._steps.knows_motion:
            tracked = self._confirmed(frame, last_from_cam, is_lost=is_lost, is_alone=True)
        if tracked is None:
            return Failure(FailureReason.FEW_INLIERS)
        failure = self._steps.failure(self._step(frame, tracked))
        if failure is None:
            return tracked
        other = self._confirmed(frame, None, is_lost=is_lost)
        if other is not None and self._steps.failure(self._step(frame, other)) is None:
            return other
        self._steps.reject(self._step(frame, tracked))
        return failure

    def _step(self, frame: PreprocessedFrame, tracked: TrackedFrame) -> Step:
        predicted = self._motion.predict(frame.stamp_ns)
        pose, ratio = tracked.world_from_cam, tracked.inlier_ratio
        return Step(frame.stamp_ns, self._motion.last, predicted, pose, ratio)

    def _confirmed(
        self,
        frame: PreprocessedFrame,
        last_from_cam: Floats | None,
        *,
        is_lost: bool,
        is_alone: bool = False,
    ) -> TrackedFrame | None:
        """The first initial pose that refinement confirms; None if too few landmarks agree.

        One from sparse image alignment with few inliers competes with the next one.
        """
        best: TrackedFrame | None = None
        initial_poses = self._initial_poses(
            frame, last_from_cam, is_lost=is_lost, is_alone=is_alone
        )
        for initial in initial_poses:
            tracked = self.refine(frame, initial.world_from_cam, is_alone=is_alone)
            if best is None or (tracked is not None and self._is_better(tracked, best)):
                best = tracked
            if best is None or best.inliers < initial.sufficient_inliers:
                continue
            if self.knows_velocity or best.inlier_ratio > _MIN_FIRST_RATIO:
                return best
        if best is not None and not self.knows_velocity:
            pose = self.relocalize(frame, without=best.observed.rows[best.inlier])
            second = None if pose is None else self.refine(frame, pose, is_alone=is_alone)
            if second is not None and self._is_better(second, best):
                best = second
        return best

    def _is_better(self, tracked: TrackedFrame, best: TrackedFrame) -> bool:
        """Whether a pose is at least as good as another: in the first step by the area it explains.

        Near things have the most landmarks, but less of the image than what stands still.
        """
        if self.knows_velocity:
            return tracked.inliers >= best.inliers
        return self._cells(tracked) >= self._cells(best)

    def _cells(self, tracked: TrackedFrame) -> int:
        """Number of square parts of the image, 16 in a row, with a landmark that agrees."""
        xy = tracked.observed.image_xy[tracked.inlier]
        cells = np.floor(xy * (16.0 / self._map.rig.width)).astype(np.int64)
        return len(np.unique(cells, axis=0))

    def _initial_poses(
        self,
        frame: PreprocessedFrame,
        last_from_cam: Floats | None,
        *,
        is_lost: bool,
        is_alone: bool,
    ) -> Iterator[_InitialPose]:
        """Poses to refine, the most accurate and cheapest first."""
        if self.last is not None and last_from_cam is not None:
            enough = _MIN_SPARSE_RATIO * int(np.count_nonzero(self.last.inlier))
            yield _InitialPose(self._motion.last @ last_from_cam, enough)
        predicted = self._motion.predict(frame.stamp_ns)
        if self._motion.prior(frame.stamp_ns) is not None:
            yield _InitialPose(predicted)
        pose = self.track_by_projection(frame, predicted, _RADII)
        if pose is not None:
            yield _InitialPose(pose)
        if is_lost:  # the camera may have stopped as well as gone on
            pose = self.track_by_projection(frame, self._motion.last, _RADII_LOST)
            if pose is not None:
                yield _InitialPose(pose)
        else:
            yield _InitialPose(predicted)
        pose = self.relocalize(frame)
        if pose is not None:
            yield _InitialPose(pose)
        if (is_alone or not self._map.rig.is_metric) and self.last is not None:
            pose = self._essential_matrix.estimate(self.last, self._motion.last, frame)
            if pose is not None:
                yield _InitialPose(pose)

    def track_by_projection(
        self, frame: PreprocessedFrame, predicted: Floats, radii: tuple[float, ...] = _RADII
    ) -> Floats | None:
        """world_from_cam from descriptors near where a predicted pose (4, 4) projects landmarks."""
        velocity = self._shutter.velocity(frame.stamp_ns, predicted)
        visible = visible_landmarks(self._map, predicted, velocity=velocity)
        rows = visible.rows
        octave = predicted_octave(self._map.octave[rows], visible.scale, self._scale_factor)
        query = replace(self._features_of(rows), xy=visible.image_xy, octave=octave)
        radius_px = self._config.search_ratio * self._map.rig.width
        for factor in radii:
            region = Circles(np.full(len(rows), factor * radius_px))
            matches = self._matcher.match(query, feature_set(frame.keypoints), region)
            pose = self._pose(frame, rows[matches.query], matches.train)
            if pose is not None:
                return pose
        return None

    def relocalize(self, frame: PreprocessedFrame, without: Ints | None = None) -> Floats | None:
        """world_from_cam from descriptors alone, without some rows of the map.

        Landmarks have positions as the camera of the last pose would see them, for matchers that
        compare how features lie to each other; NaN outside of its view.
        """
        visible = visible_landmarks(self._map, self._motion.last)
        xy = np.full((len(self._map), 2), np.nan)
        xy[visible.rows] = visible.image_xy
        size = self._map.rig.width, self._map.rig.height
        query = replace(self._features_of(np.arange(len(self._map))), xy=xy, size=size)
        matches = self._matcher.match(query, feature_set(frame.keypoints, size=size))
        if without is None:
            return self._pose(frame, matches.query, matches.train)
        is_used = np.isin(matches.query, without, invert=True)
        return self._pose(frame, matches.query[is_used], matches.train[is_used])

    def track_anywhere(self, frame: PreprocessedFrame) -> TrackedFrame | None:
        """Track a frame without a prediction."""
        pose = self.relocalize(frame)
        return None if pose is None else self.refine(frame, pose)

    @timed("align")
    def refine(
        self, frame: PreprocessedFrame, world_from_cam: Floats, *, is_alone: bool = False
    ) -> TrackedFrame | None:
        """Align all landmarks in view, starting at a pose (4, 4), and fit the pose to them.

        None if too few of them agree. With the left image alone, landmarks that have been seen only
        once do not count as missing: a pair makes landmarks of snowflakes, too, which two views at
        different times don't.
        """
        velocity = self._shutter.velocity(frame.stamp_ns, world_from_cam)
        visible = visible_landmarks(self._map, world_from_cam, self._config.max_landmarks, velocity)
        visible = self._aligner.candidates(outside(frame.masks[0], visible), self.last)
        observed = self._aligner.align(visible, frame, self.last)
        if not is_alone:
            observed = self._aligner.with_disparity(observed, world_from_cam, frame)
        fit = self._estimator.refine(
            self._shutter.at_middle_row(observed, world_from_cam, velocity), world_from_cam
        )
        if velocity is not None:
            refined = inverse(fit.cam_from_world)
            velocity = self._shutter.velocity(frame.stamp_ns, refined)
            observed = self._shutter.at_middle_row(observed, refined, velocity)
            fit = self._estimator.refine(observed, refined)
        in_view = len(visible.rows)
        if is_alone:
            in_view = int(np.count_nonzero(self._map.found[visible.rows] > 1))
        self._map.visible[visible.rows] += 1
        self._map.found[observed.rows[fit.inlier]] += 1
        if np.count_nonzero(fit.inlier) < self._min_inliers(in_view):
            return None
        cam_from_world, prior = fit.cam_from_world, self._motion.prior(frame.stamp_ns)
        if prior is not None:
            if not prior.leads and prior.is_contradicted(cam_from_world, fit.information):
                return None
            cam_from_world = prior.fused(cam_from_world, fit.information)
        ids, pose = self._map.id.take(observed.rows), inverse(cam_from_world)
        information = fit.information if prior is None else None
        return TrackedFrame(pose, ids, observed, fit.inlier, in_view, velocity, information)

    def _min_inliers(self, visible: int) -> float:
        """Minimum number of inliers; half as many where they are most of the landmarks in view."""
        usual = self._config.min_inliers
        fewest = min(usual, max(usual, visible) / 2)
        return max(fewest, self._config.min_inlier_ratio * visible)

    def _features_of(self, rows: Ints) -> FeatureSet:
        """Landmarks by row as features to match."""
        m = self._map
        return FeatureSet(None, m.octave[rows], m.angle[rows], m.descriptor[rows])

    def _pose(self, frame: PreprocessedFrame, rows: Ints, features: Ints) -> Floats | None:
        """world_from_cam from landmarks (n,) matched with features (n,)."""
        octave = frame.keypoints.octave[features].astype(np.float64)
        xy = self._map.rig.undistort(frame.keypoints.xy[features])
        return self._estimator.from_matches(rows, xy, self._scale_factor**octave)


def median_motion_px(local_map: LocalMap, ids: Ints, last: Floats, now: Floats) -> float:
    """Median motion of landmarks in the image between two poses (4, 4) of a camera, or 0."""
    rows = local_map.rows(ids)
    xyz = local_map.xyz[rows[rows >= 0]]
    before, after = (transform_points(inverse(pose), xyz) for pose in (last, now))
    seen = (before[:, 2] > 0) & (after[:, 2] > 0)
    if not seen.any():
        return 0.0
    motion = local_map.rig.project(after[seen]) - local_map.rig.project(before[seen])
    return median(np.hypot(motion[:, 0], motion[:, 1]))
