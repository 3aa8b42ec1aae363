"""Mono, the map too thin for PnP: the essential matrix gives the motion, the map its length."""

from __future__ import annotations

import numpy as np

from vo.config import Config
from vo.frontend.matching import agree_in_rotation, match_everywhere
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry import epipolar
from vo.geometry.rectification import RectifiedRig
from vo.geometry.transforms import inverse, transform_points
from vo.mapping.local_map import Map
from vo.snapshot import LastFrame
from vo.tracking.scale import scale_from_points
from vo.types import Floats, Floats32, Ints

_MIN_SUPPORT = 6
_SAME_PX = 3.0


def essential_matrix_fallback(
    world: Map,
    last: LastFrame,
    world_from_last: Floats,
    frame: PreprocessedFrame,
    rig: RectifiedRig,
    config: Config,
) -> Floats | None:
    """world_from_cam by frame-to-frame motion; None unless some landmarks confirm its scale.

    Args:
        world: the map.
        last: the last tracked frame and what it sees.
        world_from_last: its pose.
        frame: the frame to place.
        rig: the working camera.
        config: all settings.
    """
    tracking = config.tracking
    a, b = last.frame.keypoints, frame.keypoints
    matched = match_everywhere(
        a.descriptor, b.descriptor, max_distance=tracking.max_hamming, ratio=tracking.ratio
    )
    query = np.flatnonzero(matched >= 0)
    query = query[agree_in_rotation(a.angle[query], b.angle[matched[query]])]
    if len(query) < config.start.min_matches:
        return None
    first, second = (rig.undistort(xy) for xy in (a.xy[query], b.xy[matched[query]]))
    found = epipolar.find_essential(first, second, rig.matrix, config.start.threshold_px)
    if found is None or int(found[1].sum()) < config.start.min_points:
        return None
    motion = epipolar.recover_motion(found[0], first, second, rig.matrix, found[1])
    query, second = query[found[1]], second[found[1]]
    rows, at = _landmarks_of(world, a.xy[query], last.ids, last.image_xy)
    in_last = transform_points(inverse(world_from_last), world.xyz[rows])
    rays = (second[at] - (rig.cx, rig.cy)) / (rig.fx, rig.fy)
    scale, support = scale_from_points(motion, in_last, rays)
    if support < _MIN_SUPPORT or support < 0.5 * len(rows):
        return None
    motion[:3, 3] *= scale
    return np.asarray(world_from_last @ inverse(motion))


def _landmarks_of(
    world: Map, feature_xy: Floats32, ids: Ints, landmark_xy: Floats
) -> tuple[Ints, Ints]:
    """Map rows of landmarks seen where features (n, 2) are, and the rows of those features."""
    rows = world.rows(ids)
    landmark_xy, rows = landmark_xy[rows >= 0], rows[rows >= 0]
    if len(rows) == 0 or len(feature_xy) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    distance = np.linalg.norm(feature_xy[:, None] - landmark_xy[None], axis=2)
    nearest = np.argmin(distance, axis=1)
    at = np.flatnonzero(distance[np.arange(len(nearest)), nearest] < _SAME_PX)
    return rows[nearest[at]], at
