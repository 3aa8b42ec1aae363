"""Motion since the last frame from the patches of its landmarks, without features.

Source: Forster et al., SVO, 2014, sec. IV-A (sparse image alignment).
"""

from __future__ import annotations

import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bools, Bytes, Floats
from vo.engine.frontend.camera_alignment import align_sparse
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.image_masks import used_at
from vo.engine.geometry.rolling_shutter import Velocity, as_seen
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import LastFrame

_MAX_LANDMARKS = 200  # evenly chosen
_MIN_LANDMARKS = 20
_FAR_PX = 1e6  # beyond any image
_MIN_SCORE, _MIN_SCORE_RATIO = 0.7, 0.3  # minimum ratio of patches that correlate as much


def sparse_image_alignment(
    local_map: LocalMap,
    last: LastFrame,
    world_from_last: Floats,
    frame: PreprocessedFrame,
    predicted: Floats,
    velocity: Velocity | None = None,
) -> Floats | None:
    """last_from_cam (4, 4) at which landmarks look as in the last frame; None if it is unclear.

    `last` and its pose (4, 4) are of the frame before; `predicted` (4, 4) is where to start.
    """
    rig = local_map.rig
    rows = local_map.rows(last.ids)
    seen = np.flatnonzero((rows >= 0) & last.inlier)
    seen = seen[:: max(1, len(seen) // _MAX_LANDMARKS)]
    if len(seen) < _MIN_LANDMARKS:
        return None
    points = transform_points(inverse(world_from_last), local_map.xyz.take(rows[seen], axis=0))
    start = inverse(predicted) @ world_from_last
    if frame.masks[0] is not None:
        kept = _shown(transform_points(start, points), frame.masks[0], rig)
        seen, points = seen[kept], points[kept]
        if len(seen) < _MIN_LANDMARKS:
            return None
    found = align_sparse(
        last.frame.pyramid,
        last.image_xy[seen],
        frame.pyramid,
        points,
        start,
        _distortion_near(start, points, rig, velocity),
        rig.intrinsics,
    )
    if np.count_nonzero(found.score >= _MIN_SCORE) / len(points) < _MIN_SCORE_RATIO:
        return None
    return inverse(found.target_from_reference)


def _shown(points: Floats, mask: Bytes, rig: RectifiedRig) -> Bools:
    """(N,) whether points (N, 3) before the camera lie where a mask hides nothing."""
    kept = points[:, 2] > 0.0
    xy = rig.distort(rig.project(points[kept]))
    is_near = (np.abs(xy) < _FAR_PX).all(axis=1)
    kept[kept] = is_near
    kept[kept] = used_at(mask, xy[is_near])
    return kept


def _distortion_near(
    start: Floats, points: Floats, rig: RectifiedRig, velocity: Velocity | None
) -> Floats:
    """Affine maps (N, 2, 3) from ideal pixels to those of the image.

    Near points (N, 3), which `start` (4, 4) takes to the camera.
    """
    affine = np.zeros((len(points), 2, 3))
    affine[:, 0, 0] = affine[:, 1, 1] = 1.0
    if rig.lens is None and velocity is None:
        return affine
    in_cam = transform_points(start, points)
    xy = rig.project(in_cam)
    if rig.lens is not None:
        affine = _lens_near(xy, rig)
    if velocity is not None:
        affine[:, :, 2] += as_seen(rig, xy, 1.0 / in_cam[:, 2], velocity) - rig.distort(xy)
    return affine


def _lens_near(xy: Floats, rig: RectifiedRig) -> Floats:
    beside = np.concatenate([xy, xy + (1.0, 0.0), xy + (0.0, 1.0)])
    at, right, down = rig.distort(beside).reshape(3, -1, 2)
    linear = np.stack([right - at, down - at], axis=2)
    shift = at - np.einsum("nij,nj->ni", linear, xy)
    return np.concatenate([linear, shift[:, :, None]], axis=2)
