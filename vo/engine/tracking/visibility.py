"""Landmarks that a camera should see."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.transforms import inverse
from vo.base.types import Bytes, Floats, Ints
from vo.engine.geometry.image_masks import used_at
from vo.engine.geometry.patch_prediction import points_in_view, predict_patches
from vo.engine.geometry.rolling_shutter import Velocity, as_seen
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.patch_search import BORDER_PX, MAX_SCALE

_MAX_COUNT = 20  # times found, from which landmarks are ranked alike


@frozen(eq=False)
class Visible:
    """Landmarks that should be in the image; rows belong together.

    Attributes:
        rows: (n,) rows of the map.
        xy: (n, 2) predicted ideal pixels.
        image_xy: (n, 2) the same in the rectified image.
        scale: (n,) size of the patch relative to its reference.
        reference_from_image: (n, 2, 2) how pixel steps in the image map to the reference image.
        slope: (n, 2) change of inverse depth from pixel to pixel, relative to it, 1/px.
    """

    rows: Ints
    xy: Floats
    image_xy: Floats
    scale: Floats
    reference_from_image: Floats
    slope: Floats

    def select(self, rows: Ints) -> Visible:
        """Some of them."""
        return Visible(*(getattr(self, field.name)[rows] for field in fields(Visible)))


def visible_landmarks(
    local_map: LocalMap,
    world_from_cam: Floats,
    max_count: int | None = None,
    velocity: Velocity | None = None,
) -> Visible:
    """The landmarks that a camera at a pose (4, 4) should see, with a velocity for their rows.

    Of more than `max_count` those found most often, then the newest.
    """
    rig, keyframes = local_map.rig, local_map.keyframes
    poses = np.array([*(k.world_from_cam for k in keyframes), world_from_cam])
    first = keyframes[0].id if keyframes else 0
    reference = local_map.reference - first
    inside = (BORDER_PX, BORDER_PX, rig.width - BORDER_PX, rig.height - BORDER_PX)
    everywhere = (-np.inf, -np.inf, np.inf, np.inf)
    is_ideal = rig.lens is None and velocity is None
    corners = inside if is_ideal else everywhere
    rows, xy = points_in_view(local_map.xyz, reference, poses, rig.intrinsics, MAX_SCALE, corners)
    image_xy = rig.distort(xy)
    if velocity is not None:
        image_xy = as_seen(rig, xy, _inverse_depth(local_map, rows, world_from_cam), velocity)
    if not is_ideal:
        u, v = image_xy[:, 0], image_xy[:, 1]
        left, top, right, bottom = inside
        kept = np.flatnonzero((u >= left) & (u < right) & (v >= top) & (v < bottom))
        rows, xy, image_xy = rows.take(kept), xy.take(kept, axis=0), image_xy.take(kept, axis=0)
    if max_count is not None and len(rows) > max_count:
        found = np.minimum(local_map.found.take(rows), _MAX_COUNT)
        rank = found * len(local_map) + rows  # rows are in order of the landmarks' ids
        first = len(rank) - max_count
        kept = (rank >= np.partition(rank, first)[first]).nonzero()[0]
        rows, xy, image_xy = rows.take(kept), xy.take(kept, axis=0), image_xy.take(kept, axis=0)
    here = np.full(len(rows), len(poses) - 1)
    seen = predict_patches(
        local_map.xyz, local_map.normal, reference, rows, here, poses, rig.intrinsics
    )
    return Visible(rows, xy, image_xy, seen.scale, seen.reference_from_target, seen.slope)


def _inverse_depth(local_map: LocalMap, rows: Ints, world_from_cam: Floats) -> Floats:
    """(n,) of landmarks in front of a camera."""
    cam_from_world = inverse(world_from_cam)
    return np.asarray(1.0 / (local_map.xyz[rows] @ cam_from_world[2, :3] + cam_from_world[2, 3]))


def outside(mask: Bytes | None, visible: Visible) -> Visible:
    """The landmarks whose predicted pixels are not where a mask (H, W) is 0; all without a mask."""
    if mask is None:
        return visible
    return visible.select(np.flatnonzero(used_at(mask, visible.image_xy)))
