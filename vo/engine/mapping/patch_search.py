"""Search for landmarks in keyframes of the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Floats, Ints
from vo.engine.frontend.patch_alignment import PatchAligner, Patches
from vo.engine.geometry.homographies import homographies
from vo.engine.geometry.image_masks import used_at
from vo.engine.geometry.neighbours import distances
from vo.engine.geometry.patch_prediction import predict_patches
from vo.engine.geometry.rolling_shutter import as_seen, at_middle_row
from vo.engine.mapping.local_map import LocalMap

BORDER_PX = 8.0  # of an image, where no patch is searched
MAX_SCALE = 2.0  # maximum size ratio of a patch and its reference


class FoundPatches(NamedTuple):
    """Landmarks found in keyframes; rows belong together.

    Attributes:
        rows: (n,) rows of the map.
        camera: (n,) index in `LocalMap.keyframes`.
        xy: (n, 2) ideal pixels there.
        image_xy: (n, 2) the same in its rectified image.
    """

    rows: Ints
    camera: Ints
    xy: Floats
    image_xy: Floats


def find_patches(
    local_map: LocalMap, rows: Ints, camera: Ints, patches: PatchAligner, *, of_rig: bool = False
) -> FoundPatches:
    """Find landmarks (N,), by row, to sub-pixel in keyframes (N,) that may show them.

    `of_rig`: whether keyframes may look to other sides than those with the patches.
    """
    rig = local_map.rig
    reference = local_map.reference - local_map.keyframes[0].id
    slots = np.array([k.slot for k in local_map.keyframes])
    seen = predict_patches(
        local_map.xyz, local_map.normal, reference, rows, camera, local_map.poses, rig.intrinsics
    )
    kept = ((seen.scale < MAX_SCALE) & (seen.scale > 1.0 / MAX_SCALE)).nonzero()[0]
    near = _inverse_depth(local_map, rows[kept], camera[kept])
    expected = _as_seen(local_map, camera[kept], seen.xy.take(kept, axis=0), near)
    farthest = (rig.width - BORDER_PX, rig.height - BORDER_PX)
    inside = np.flatnonzero(((expected >= BORDER_PX) & (expected < farthest)).all(axis=1))
    inside = inside[_shown(local_map, camera[kept[inside]], expected[inside])]
    kept, expected = kept[inside], expected.take(inside, axis=0)
    rows, camera = rows[kept], camera[kept]
    warp = seen.reference_from_target.take(kept, axis=0)
    if of_rig:
        targets = local_map.poses, camera
        warp = map_homographies(local_map, rows, targets, warp, seen.xy[kept], seen.slope[kept])
    slot, at = slots[reference[rows]], local_map.reference_xy[rows]
    references = Patches(local_map.images, slot, at, warp)
    found = patches.align_in(references, local_map.images, slots[camera], expected)
    ideal = _at_middle_row(local_map, camera, found.xy, near[inside])
    good = patches.is_found(found) & (distances(found.xy, expected) <= patches.max_shift_px)
    good &= np.isfinite(ideal).all(axis=1)
    return FoundPatches(rows[good], camera[good], ideal[good], found.xy[good])


def map_homographies(
    local_map: LocalMap,
    rows: Ints,
    targets: tuple[Floats, Ints],
    affine: Floats,
    xy: Floats,
    slope: Floats,
) -> Floats:
    """Warps (N, 3, 2) of landmarks (N,), by row, of affine ones (N, 2, 2).

    `targets`: poses (K, 4, 4) and the row of each landmark's (N,); `xy`, `slope`: as predicted.
    """
    poses, camera = targets
    target_from_world, xyz = inverse(poses)[camera, 2], local_map.xyz[rows]
    depth = np.einsum("ni,ni->n", target_from_world[:, :3], xyz) + target_from_world[:, 3]
    reference = inverse(local_map.poses)[local_map.reference[rows] - local_map.keyframes[0].id, 2]
    by_target = np.einsum("ni,nij->nj", reference, poses[camera])
    return homographies(affine, xy, by_target, 1.0 / depth, slope, local_map.rig.intrinsics)


def _inverse_depth(local_map: LocalMap, rows: Ints, camera: Ints) -> Floats:
    """(N,) of landmarks in front of keyframes; 0 if no keyframe needs it."""
    if all(keyframe.velocity is None for keyframe in local_map.keyframes):
        return np.zeros(len(rows))
    cam_from_world = inverse(local_map.poses)[camera, 2]
    depth = np.einsum("ni,ni->n", cam_from_world[:, :3], local_map.xyz[rows])
    return np.asarray(1.0 / (depth + cam_from_world[:, 3]))


def _as_seen(local_map: LocalMap, camera: Ints, xy: Floats, near: Floats) -> Floats:
    """Pixels (N, 2) in the images of keyframes (N,), of ideal ones at inverse depths (N,)."""
    image_xy = local_map.rig.distort(xy)
    for number, keyframe in enumerate(local_map.keyframes):
        if keyframe.velocity is not None:
            here = camera == number
            image_xy[here] = as_seen(local_map.rig, xy[here], near[here], keyframe.velocity)
    return image_xy


def _at_middle_row(local_map: LocalMap, camera: Ints, image_xy: Floats, near: Floats) -> Floats:
    """Ideal pixels (N, 2) of those in the images of keyframes (N,)."""
    xy = local_map.rig.undistort(image_xy)
    for number, keyframe in enumerate(local_map.keyframes):
        if keyframe.velocity is not None:
            here = camera == number
            xy[here] = at_middle_row(local_map.rig, image_xy[here], near[here], keyframe.velocity)
    return xy


def _shown(local_map: LocalMap, camera: Ints, xy: Floats) -> Bools:
    """(N,) whether pixels (N, 2) in the images of keyframes (N,) are where these are used."""
    shown = np.ones(len(xy), dtype=bool)
    for number, keyframe in enumerate(local_map.keyframes):
        if keyframe.mask is not None:
            here = camera == number
            shown[here] = used_at(keyframe.mask, xy[here])
    return shown
