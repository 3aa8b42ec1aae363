"""First map of a stereo pair or a depth camera, from one frame."""

from __future__ import annotations

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.types import Floats
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.local_mapper import LocalMapper


class StereoInitializer:
    """Starts a map from the disparities of one frame.

    Args:
        min_points: minimum number of landmarks of the map.
    """

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
