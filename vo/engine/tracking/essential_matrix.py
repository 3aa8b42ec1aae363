"""Frame-to-frame motion of a single camera where the map is too thin for PnP."""

from __future__ import annotations

import numpy as np

from vo.base.config import StartConfig
from vo.base.geometry.quantiles import median
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Floats, Floats32, Ints
from vo.engine.frontend.contracts import Matcher, feature_set
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry import epipolar
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import LastFrame

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


def scale_from_points(
    now_from_last: Floats, points_last: Floats, rays_now: Floats, *, agreement: float = 0.3
) -> tuple[float, int]:
    """Scale of a unit translation, and how many points agree with it.

    Args:
        now_from_last: (4, 4) motion with a translation of length 1.
        points_last: (N, 3) map points in the last camera's frame.
        rays_now: (N, 2) where they are seen now, x/z and y/z.
        agreement: share by which a point's own scale may differ from the median.

    With q = R p and direction t, (q + s t) is parallel to the ray (x, y, 1), so each point gives
    s = (x q_z - q_x) / (t_x - x t_z), likewise in y; the two are joined by least squares.
    """
    q = points_last @ now_from_last[:3, :3].T
    t = now_from_last[:3, 3]
    slope = t[:2] - rays_now * t[2]
    offset = rays_now * q[:, 2:] - q[:, :2]
    weight = np.sum(slope**2, axis=1)
    usable = weight > 1e-12
    if not usable.any():
        return 0.0, 0
    scales = np.sum(slope * offset, axis=1)[usable] / weight[usable]
    scale = median(scales)
    if scale <= 0:
        return scale, 0
    return scale, int(np.sum(np.abs(scales - scale) <= agreement * scale))
