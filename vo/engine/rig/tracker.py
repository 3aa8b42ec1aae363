"""Tracking of a rig: one pose from the landmarks in all views."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vo.base.config import TrackingConfig
from vo.base.failures import Failure, FailureReason
from vo.base.geometry.transforms import inverse
from vo.base.stopwatch import Stopwatch, timed
from vo.base.types import Floats
from vo.engine.frontend.contracts import FeatureSet, feature_set
from vo.engine.frontend.frontend import Frontend
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import TrackedFrame
from vo.engine.rig.frames import RigFrame
from vo.engine.rig.pose_fit import RigObservations, RigTies, fit_rig
from vo.engine.rig.tracked import LastRigFrame, RigTracked, landmarks_per_view, unobserved
from vo.engine.rig.velocity import BodyVelocity
from vo.engine.tracking.landmark_alignment import LandmarkAligner
from vo.engine.tracking.motion_model import MotionModel, PosePrior
from vo.engine.tracking.pose_estimation import PoseEstimator
from vo.engine.tracking.sparse_image_alignment import sparse_image_alignment
from vo.engine.tracking.step_check import Step, StepCheck
from vo.engine.tracking.visibility import Visible, outside, visible_landmarks

_MIN_SPARSE_RATIO = 0.5  # of the last frame's inliers, that confirms a pose at once
_ALIGNED_VIEWS = 2  # views with the most landmarks that are tried by sparse image alignment


class RigTracker:
    """Tracks frames in the local map; holds the motion model and the last frame.

    Attributes:
        body_from_views: (V, 4, 4) in units of the map.
        last: the last tracked frame, None before the first of a segment.
        knows_velocity: whether two frames of the segment have been tracked.
    """

    def __init__(
        self,
        local_map: LocalMap,
        frontend: Frontend,
        config: TrackingConfig,
        body_from_views: Floats,
        stopwatch: Stopwatch,
        motion: MotionModel,
    ) -> None:
        self.body_from_views = body_from_views
        self.last: LastRigFrame | None = None
        self.knows_velocity = False
        self.motion = motion
        self.stopwatch = stopwatch
        self._velocity = BodyVelocity()
        self._steps = StepCheck(is_metric=True)
        self._map = local_map
        self._config = config
        self._matcher = frontend.matcher
        self._scale_factor = frontend.scale_factor
        self._aligner = LandmarkAligner(local_map, frontend, config.min_inliers)
        self._estimator = PoseEstimator(local_map, 1.0, config)
        self._most = landmarks_per_view(config.max_landmarks, len(body_from_views))

    def restart(self, frame: RigFrame, tracked: RigTracked, *, is_metric: bool) -> None:
        """Begin at a frame that a new map was made of, with unknown velocity."""
        self.motion.restart(frame.stamp_ns, tracked.world_from_body)
        self._velocity.restart()
        self._steps = StepCheck(is_metric=is_metric)
        self._steps.restart(frame.stamp_ns)
        self.last, self.knows_velocity = LastRigFrame(frame, tracked), False

    def ahead(self, stamp_ns: int) -> Floats | PosePrior | None:
        """The pose of the body after the newest frame; None if it is unknown."""
        return None if self.last is None else self.motion.ahead(stamp_ns)

    def update(self, frame: RigFrame, tracked: RigTracked) -> LastRigFrame | None:
        """Continue from a tracked frame.

        Returns:
            The frame before with its views where this one shows that they are, if they have
            different times.
        """
        self._steps.update(self._step(frame, tracked))
        before, moved = self.last, None
        if any(frame.delay_s) and before is not None:
            elapsed_s = 1e-9 * (frame.stamp_ns - before.frame.stamp_ns)
            poses = self.motion.last, tracked.world_from_body
            moved = self._velocity.update(*poses, elapsed_s, before.frame.delay_s)
        self.motion.update(frame.stamp_ns, tracked.world_from_body)
        self.last, self.knows_velocity = LastRigFrame(frame, tracked), True
        if before is None or moved is None:
            return None
        tied = moved @ self.body_from_views
        return replace(before, tracked=replace(before.tracked, body_from_views=tied))

    def move_views(self, by: Floats) -> None:
        """Fix the views (V, 4, 4) elsewhere on the body."""
        self.body_from_views = self.body_from_views @ by
        if self.last is not None:
            tracked = self.last.tracked
            tracked = replace(tracked, body_from_views=tracked.body_from_views @ by)
            self.last = replace(self.last, tracked=tracked)

    def ties(self, frame: RigFrame, world_from_body: Floats) -> RigTies:
        """The views at the times of a frame's images, for a pose of the body."""
        ties = RigTies(self.body_from_views, np.array(frame.delay_s), np.zeros(6))
        if not any(frame.delay_s) or self.last is None:
            return ties
        elapsed_s = 1e-9 * (frame.stamp_ns - self.last.frame.stamp_ns)
        if elapsed_s <= 0.0:
            return ties
        prior = self._velocity.prior(self.motion.last, elapsed_s)
        return ties._replace(twist=prior.velocity(world_from_body), prior=prior)

    @timed("match")
    def track(self, frame: RigFrame, *, is_lost: bool) -> RigTracked | Failure:
        """The pose of a frame, or why it has none.

        A step that the motion before does not support is tried again from other initial poses.
        """
        tracked = self._confirmed(frame, is_lost=is_lost)
        if tracked is None:
            return Failure(FailureReason.FEW_INLIERS)
        failure = self._steps.failure(self._step(frame, tracked))
        if failure is None:
            return tracked
        other = self._confirmed(frame, is_lost=True)
        if other is not None and self._steps.failure(self._step(frame, other)) is None:
            return other
        self._steps.reject(self._step(frame, tracked))
        return failure

    def _step(self, frame: RigFrame, tracked: RigTracked) -> Step:
        predicted, pose = self.motion.predict(frame.stamp_ns), tracked.world_from_body
        return Step(frame.stamp_ns, self.motion.last, predicted, pose, tracked.inlier_ratio)

    def _confirmed(self, frame: RigFrame, *, is_lost: bool) -> RigTracked | None:
        """The pose on which the most landmarks agree; None if those are too few."""
        best: RigTracked | None = None
        enough = 0.0
        if self.last is not None and not is_lost:
            enough = _MIN_SPARSE_RATIO * self.last.tracked.inliers
        for pose in self._initial_poses(frame, is_lost=is_lost):
            tracked = self.refine(frame, pose)
            if tracked is not None and (best is None or tracked.inliers > best.inliers):
                best = tracked
            if best is not None and best.inliers >= enough:
                return best
        return best

    def _initial_poses(self, frame: RigFrame, *, is_lost: bool) -> Iterator[Floats]:
        """Poses of the body to refine, the most accurate and cheapest first."""
        predicted = self.motion.predict(frame.stamp_ns)
        if not is_lost:
            yield from self._by_alignment(frame, predicted)
        yield predicted
        if is_lost:
            yield self.motion.last
        for view, is_used in enumerate(frame.used):
            if is_used:
                pose = self._relocalize(frame, view)
                if pose is not None:
                    yield pose

    def _by_alignment(self, frame: RigFrame, predicted: Floats) -> Iterator[Floats]:
        """By sparse image alignment in the views that had the most landmarks."""
        if self.last is None:
            return
        last, tied = self.last, self.ties(frame, predicted).at_their_times
        counts = [v.inliers * used for v, used in zip(last.tracked.views, frame.used, strict=True)]
        for view in np.argsort(counts)[::-1][:_ALIGNED_VIEWS].tolist():
            before, image = last.in_view(view), frame.views[view]
            # The body of the last frame may have moved with the map since.
            pose = self.motion.last @ last.tracked.body_from_views[view]
            motion = sparse_image_alignment(self._map, before, pose, image, predicted @ tied[view])
            if motion is not None:
                yield np.asarray(pose @ motion @ inverse(tied[view]))

    def _relocalize(self, frame: RigFrame, view: int) -> Floats | None:
        """By the descriptors of one view, wherever in the map."""
        local_map, image = self._map, frame.views[view]
        query = FeatureSet(None, local_map.octave, local_map.angle, local_map.descriptor)
        matches = self._matcher.match(query, feature_set(image.keypoints))
        keypoints = image.keypoints.select(matches.train)
        sigma_px = self._scale_factor ** keypoints.octave.astype(np.float64)
        xy = keypoints.xy.astype(np.float64)
        pose = self._estimator.from_matches(matches.query, xy, sigma_px)
        return None if pose is None else np.asarray(pose @ inverse(self.body_from_views[view]))

    @timed("align")
    def refine(self, frame: RigFrame, world_from_body: Floats) -> RigTracked | None:
        """Align the landmarks in all views, starting at a pose (4, 4), and fit the pose to them."""
        ties = self.ties(frame, world_from_body)
        tied = ties.at_their_times
        visible = [self._visible(frame, v, world_from_body @ tied[v]) for v in range(len(tied))]
        observed = []
        for v, seen in enumerate(visible):
            self._aligner.world_from_image = world_from_body @ tied[v]
            found = None if seen is None else self._aligner.align(seen, frame.views[v], None)
            observed.append(unobserved() if found is None else found)
        numbers = np.repeat(np.arange(len(observed)), [len(each) for each in observed])
        stacked = RigObservations(
            self._map.xyz[np.concatenate([each.rows for each in observed])],
            np.concatenate([each.xy for each in observed]),
            np.concatenate([each.sigma_px for each in observed]),
            numbers,
        )
        in_view = [0 if seen is None else len(seen.rows) for seen in visible]
        fit = fit_rig(
            inverse(world_from_body), stacked, ties, self._map.rig.intrinsics, self._config.gate
        )
        pose, tied = fit.body_from_world, fit.ties.at_their_times
        for v, seen in enumerate(visible):
            if seen is not None:
                self._map.visible[seen.rows] += 1
                self._map.found[observed[v].rows[fit.inlier[numbers == v]]] += 1
        if int(fit.inlier.sum()) < self._min_inliers(sum(in_view)):
            return None
        body = inverse(pose)
        views = tuple(
            TrackedFrame(
                body @ tied[v], self._map.id[o.rows], o, fit.inlier[numbers == v], in_view[v]
            )
            for v, o in enumerate(observed)
        )
        return RigTracked(body, tied, views)

    def _visible(self, frame: RigFrame, view: int, world_from_view: Floats) -> Visible | None:
        if not frame.used[view]:
            return None
        seen = visible_landmarks(self._map, world_from_view, self._most)
        return outside(frame.views[view].masks[0], seen)

    def _min_inliers(self, visible: int) -> float:
        usual = self._config.min_inliers
        fewest = min(usual, max(usual, visible) / 2)
        return max(fewest, self._config.min_inlier_ratio * visible)
