"""Look for landmarks in kept keyframes, many of each at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.config import TrackingConfig
from vo.frontend.alignment import align_between
from vo.geometry.patch_prediction import predict_patches
from vo.geometry.rectification import RectifiedRig
from vo.mapping.local_map import Map
from vo.types import Floats, Ints

# The same as for frames, in observe.py.
_BORDER_PX = 8.0
_SCALE_RANGE = 2.0


class FoundPatches(NamedTuple):
    """Landmarks found in keyframes, a row for each time.

    Attributes:
        rows: (n,) rows of the map.
        camera: (n,) which of the map's keyframes.
        xy: (n, 2) ideal pixels there.
        image_xy: (n, 2) the same in its working image.
    """

    rows: Ints
    camera: Ints
    xy: Floats
    image_xy: Floats


def find_patches(
    world: Map, rows: Ints, camera: Ints, rig: RectifiedRig, config: TrackingConfig
) -> FoundPatches:
    """Find landmarks (N,), by row, to sub-pixel in keyframes of the map (N,) that may show them."""
    reference = world.reference - world.keyframes[0].id
    poses = np.stack([k.world_from_cam for k in world.keyframes])
    slots = np.array([k.slot for k in world.keyframes])
    intrinsics = (rig.fx, rig.fy, rig.cx, rig.cy)
    seen = predict_patches(world.xyz, world.normal, reference, rows, camera, poses, intrinsics)
    kept = np.flatnonzero((seen.scale < _SCALE_RANGE) & (seen.scale > 1.0 / _SCALE_RANGE))
    expected = rig.distort(seen.xy[kept])
    farthest = (rig.width - _BORDER_PX, rig.height - _BORDER_PX)
    inside = ((expected >= _BORDER_PX) & (expected < farthest)).all(axis=1)
    kept, expected = kept[inside], expected[inside]
    rows, camera = rows[kept], camera[kept]
    found = align_between(
        world.images,
        slots[reference[rows]],
        world.reference_xy[rows],
        seen.reference_from_target[kept],
        world.images,
        slots[camera],
        expected,
        half_px=config.patch_half_px,
    )
    shift = np.linalg.norm(found.xy - expected, axis=1)
    ideal = rig.undistort(found.xy)
    good = found.converged & (found.score >= config.min_patch_score)
    good &= (shift <= config.max_shift_px) & np.isfinite(ideal).all(axis=1)
    return FoundPatches(rows[good], camera[good], ideal[good], found.xy[good])
