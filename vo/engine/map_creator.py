"""The first map of each segment, from one frame of a pair or from two of a single camera."""

from __future__ import annotations

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.types import Floats
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.map_updater import MapUpdater
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper
from vo.engine.tracking.monocular_initializer import MonocularInitializer
from vo.engine.tracking.rescue import Rescue
from vo.engine.tracking.tracker import Tracker
from vo.engine.trajectory.builder import TrajectoryBuilder


class StereoInitializer:
    """Starts a map from the disparities of one frame."""

    def __init__(self, local_map: LocalMap, mapper: LocalMapper, min_points: int) -> None:
        self._map = local_map
        self._mapper = mapper
        self._min_points = min_points

    def create_map(
        self, frame: PreprocessedFrame, world_from_cam: Floats, segment: int
    ) -> Keyframe | Failure:
        """Replace the map by a frame at a pose (4, 4) and its landmarks, or why it cannot be."""
        if not frame.has_disparity:
            return Failure(FailureReason.NO_DEPTH)
        self._map.clear()
        features = self._mapper.stereo_features(frame)
        if len(features) >= self._min_points:
            every = np.ones(len(frame.keypoints), dtype=bool)
            keyframe = self._mapper.add_first_keyframe(frame, world_from_cam, segment, every)
            self._mapper.add_stereo_landmarks(keyframe, features)
            return keyframe
        return Failure(FailureReason.FEW_LANDMARKS, len(features), self._min_points)


class MapCreator:
    """Creates the first map of a segment, from features of the second kind if the first fail.

    Args:
        stereo: creates it of a pair, or of a frame with depth.
        second: the same, from features of the second kind.
        rescue: decides whether features of the second kind may help.
    """

    def __init__(
        self,
        local_map: LocalMap,
        stereo: StereoInitializer,
        monocular: MonocularInitializer,
        second: MonocularInitializer,
        rescue: Rescue,
        tracker: Tracker,
        updater: MapUpdater,
        trajectory: TrajectoryBuilder,
    ) -> None:
        self._map = local_map
        self._stereo, self._monocular, self._second = stereo, monocular, second
        self._rescue = rescue
        self._tracker = tracker
        self._updater = updater
        self._trajectory = trajectory
        self._before: PreprocessedFrame | None = None  # the frame before, of the same start

    def restart(self) -> None:
        """Forget the frames before."""
        self._monocular.restart()
        self._second.restart()
        self._before = None

    def create_map(
        self, frame: PreprocessedFrame, pose: Floats, segment: int
    ) -> Keyframe | Failure:
        """Replace the map, where a frame at a pose (4, 4) allows it; the newest keyframe."""
        before, self._before = self._before, frame
        is_fresh = not self._monocular.waiting
        keyframe = self._create(self._monocular, frame, pose, segment)
        if isinstance(keyframe, Failure) and is_fresh and self._rescue.may_avert(keyframe):
            if not (self._map.rig.is_metric or before is None or self._second.has_reference):
                self._second.attempt(before.of_kind(is_second=True))
            again = self._create(self._second, frame.of_kind(is_second=True), pose, segment)
            keyframe = keyframe if isinstance(again, Failure) else again
        if not isinstance(keyframe, Failure):
            self.restart()
        return keyframe

    def _create(
        self,
        initializer: MonocularInitializer,
        frame: PreprocessedFrame,
        pose: Floats,
        segment: int,
    ) -> Keyframe | Failure:
        """A map from this frame of a pair, or from two frames of a single camera.

        The frames between these two had no map yet; they are tracked now, for the smoothed path.
        """
        if self._map.rig.is_metric:
            return self._stereo.create_map(frame, pose, segment)
        pair = initializer.attempt(frame)
        if isinstance(pair, Failure):
            return pair
        first, second = initializer.create_map(pair, pose, segment)
        self._updater.optimise_first_pair(first)
        for waiting in initializer.waiting:
            tracked = self._tracker.track_anywhere(waiting)
            if tracked is not None:
                self._trajectory.add_frame(waiting, first, tracked.world_from_cam)
        return second
