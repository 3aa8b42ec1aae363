"""Frame-to-frame motion of a single camera where the map is too thin for PnP."""

from __future__ import annotations

import numpy as np

from vo.base.config import StartConfig
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Floats, Floats32, Ints
from vo.engine.frontend.contracts import Matcher, feature_set
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry import epipolar
from vo.engine.mapping.local_map import LocalMap
from vo.engine.tracking.last_frame import LastFrame
from vo.engine.tracking.scale import scale_from_points

_MIN_LANDMARKS = 6  # that must agree on the scale,
_MIN_LANDMARK_RATIO = 0.5  # and their minimum ratio to all that could
_SAME_PX = 3.0  # maximum distance of a landmark from the feature that it is seen as


class EssentialMatrixFallback:
    """Motion from an essential matrix; its scale comes from landmarks of the map."""

    def __init__(self, local_map: LocalMap, matcher: Matcher, config: StartConfig) -> None:
        self._map = local_map
        self._matcher = matcher
        self._config = config

    def estimate(
        self, last: LastFrame, world_from_last: Floats, frame: PreprocessedFrame
    ) -> Floats | None:
        """world_from_cam of a frame; None unless landmarks confirm the scale.

        Args:
            last: the last tracked frame and its landmarks.
            world_from_last: (4, 4) its pose.
            frame: the frame.
        """
        rig = self._map.rig
        a, b = last.frame.keypoints, frame.keypoints
        size = rig.width, rig.height
        matches = self._matcher.match(feature_set(a, size=size), feature_set(b, size=size))
        query = matches.query
        if len(query) < self._config.min_matches:
            return None
        first, second = (rig.undistort(xy) for xy in (a.xy[query], b.xy[matches.train]))
        found = epipolar.find_essential(first, second, rig.matrix, self._config.threshold_px)
        if found is None or int(found[1].sum()) < self._config.min_points:
            return None
        essential, inlier = found
        motion = epipolar.recover_motion(essential, first, second, rig.matrix, inlier)
        query, second = query[inlier], second[inlier]
        rows, at = self._landmarks_at(a.xy[query], last)
        in_last = transform_points(inverse(world_from_last), self._map.xyz[rows])
        rays = (second[at] - (rig.cx, rig.cy)) / (rig.fx, rig.fy)
        scale, agreeing = scale_from_points(motion, in_last, rays)
        if agreeing < _MIN_LANDMARKS or agreeing < _MIN_LANDMARK_RATIO * len(rows):
            return None
        motion[:3, 3] *= scale
        return np.asarray(world_from_last @ inverse(motion))

    def _landmarks_at(self, feature_xy: Floats32, last: LastFrame) -> tuple[Ints, Ints]:
        """Map rows of landmarks seen where features (n, 2) are, and rows of those features."""
        rows = self._map.rows(last.ids)
        landmark_xy, rows = last.image_xy[rows >= 0], rows[rows >= 0]
        if len(rows) == 0 or len(feature_xy) == 0:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        distance = np.linalg.norm(feature_xy[:, None] - landmark_xy[None], axis=2)
        nearest = np.argmin(distance, axis=1)
        at = np.flatnonzero(distance[np.arange(len(nearest)), nearest] < _SAME_PX)
        return rows[nearest[at]], at
