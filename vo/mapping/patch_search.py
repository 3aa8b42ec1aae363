"""Search for landmarks in keyframes of the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.frontend.patch_alignment import PatchAligner, Patches
from vo.geometry.image_masks import used_at
from vo.geometry.patch_prediction import predict_patches
from vo.mapping.local_map import LocalMap
from vo.types import Bools, Floats, Ints

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
    local_map: LocalMap, rows: Ints, camera: Ints, patches: PatchAligner
) -> FoundPatches:
    """Find landmarks (N,), by row, to sub-pixel in keyframes (N,) that may show them."""
    rig = local_map.rig
    reference = local_map.reference - local_map.keyframes[0].id
    slots = np.array([k.slot for k in local_map.keyframes])
    seen = predict_patches(
        local_map.xyz, local_map.normal, reference, rows, camera, local_map.poses, rig.intrinsics
    )
    kept = np.flatnonzero((seen.scale < MAX_SCALE) & (seen.scale > 1.0 / MAX_SCALE))
    expected = rig.distort(seen.xy[kept])
    farthest = (rig.width - BORDER_PX, rig.height - BORDER_PX)
    inside = np.flatnonzero(((expected >= BORDER_PX) & (expected < farthest)).all(axis=1))
    inside = inside[_shown(local_map, camera[kept[inside]], expected[inside])]
    kept, expected = kept[inside], expected[inside]
    rows, camera = rows[kept], camera[kept]
    references = Patches(
        local_map.images,
        slots[reference[rows]],
        local_map.reference_xy[rows],
        seen.reference_from_target[kept],
    )
    found = patches.align_in(references, local_map.images, slots[camera], expected)
    shift = np.linalg.norm(found.xy - expected, axis=1)
    ideal = rig.undistort(found.xy)
    good = patches.is_found(found) & (shift <= patches.max_shift_px)
    good &= np.isfinite(ideal).all(axis=1)
    return FoundPatches(rows[good], camera[good], ideal[good], found.xy[good])


def _shown(local_map: LocalMap, camera: Ints, xy: Floats) -> Bools:
    """(N,) whether pixels (N, 2) in the images of keyframes (N,) are where these are used."""
    shown = np.ones(len(xy), dtype=bool)
    for number, keyframe in enumerate(local_map.keyframes):
        if keyframe.mask is not None:
            here = camera == number
            shown[here] = used_at(keyframe.mask, xy[here])
    return shown
