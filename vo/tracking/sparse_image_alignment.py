"""The motion since the last frame from how its landmarks looked there, without any features."""

from __future__ import annotations

import numpy as np

from vo.frontend.camera_alignment import align_sparse
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.rectification import RectifiedRig
from vo.geometry.transforms import inverse, transform_points
from vo.mapping.local_map import Map
from vo.snapshot import LastFrame
from vo.types import Floats

_MOST = 200  # landmarks, evenly chosen
_LEAST = 20
_CLEAR_SCORE, _CLEAR_SHARE = 0.7, 0.3  # so many patches must look like that in the end


def sparse_image_alignment(
    world: Map,
    last: LastFrame,
    world_from_last: Floats,
    frame: PreprocessedFrame,
    predicted: Floats,
    rig: RectifiedRig,
) -> Floats | None:
    """last_from_cam with which the last frame's landmarks look as they did; None if unclear.

    It hangs on the landmarks' places against the last frame only, and outlasts what smoothing
    makes of both in the world.

    Args:
        world: the map.
        last: the last tracked frame and what it sees.
        world_from_last: its pose.
        frame: the frame to place.
        predicted: world_from_cam to begin with.
        rig: the working camera.
    """
    rows = world.rows(last.ids)
    seen = np.flatnonzero((rows >= 0) & last.inlier)
    seen = seen[:: max(1, len(seen) // _MOST)]
    if len(seen) < _LEAST:
        return None
    points = transform_points(inverse(world_from_last), world.xyz[rows[seen]])
    start = inverse(predicted) @ world_from_last
    found = align_sparse(
        last.frame.smaller,
        last.image_xy[seen],
        frame.smaller,
        points,
        start,
        _distort(rig.project(transform_points(start, points)), rig),
        (rig.fx, rig.fy, rig.cx, rig.cy),
    )
    if float(np.mean(found.score >= _CLEAR_SCORE)) < _CLEAR_SHARE:
        return None
    return inverse(found.target_from_reference)


def _distort(xy: Floats, rig: RectifiedRig) -> Floats:
    """What the lens does to pixels near xy (N, 2), as affine maps (N, 2, 3)."""
    if rig.lens is None:
        return np.tile(np.eye(2, 3), (len(xy), 1, 1))
    beside = np.concatenate([xy, xy + (1.0, 0.0), xy + (0.0, 1.0)])
    at, right, down = rig.distort(beside).reshape(3, -1, 2)
    linear = np.stack([right - at, down - at], axis=2)
    shift = at - np.einsum("nij,nj->ni", linear, xy)
    return np.concatenate([linear, shift[:, :, None]], axis=2)
