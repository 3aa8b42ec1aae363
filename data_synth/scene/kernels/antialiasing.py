"""Third pass: the mean radiance over the area and the exposure of each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from data_synth.scene.kernels.beams import make_tile
from data_synth.scene.kernels.blur import blur_tile
from data_synth.scene.kernels.camera import POSE_SIZE, exposure_sweep, pose_at, store_pose
from data_synth.scene.kernels.culling import cull_again, cull_solids, empty_list
from data_synth.scene.kernels.decorators import entry_point, inlined
from data_synth.scene.kernels.packets import PACKET_SIZE
from data_synth.scene.kernels.records import (
    CULL_TILE,
    EDGE,
    UNCERTAIN,
    Candidates,
    Sampling,
    Tile,
    View,
)
from data_synth.scene.kernels.supersampling import Scratch, supersample_tile
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats, Floats32

_TILE = 8
_MAX_GROUPS = 5  # surfaces distinguished within a pixel


@entry_point
def antialias_rows(
    world: World,
    shutter: Shutter,
    rays: Floats,
    band: tuple[int, int],
    view: View,
    marks: NDArray[np.uint8],
    sampling: Sampling,
    image: Floats32,
) -> None:
    """Fill in rows band[0]…band[1] - 1 of the image.

    Where one surface fills the pixel all the time, the mean is that of the view along its motion
    (`blur`); elsewhere that of several rays (`supersampling`).

    `world`: with everything that moves in place. `rays`: (H, W, 3) of the pixels in the camera's
    frame. `marks`: (C, H, W) from `edges.mark_edges`; some pixels at the border are added.
    `sampling`: rays of marked pixels. `image`: (H, W) the result.
    """
    far, near = empty_list(world), empty_list(world)
    scratch = Scratch(
        groups=np.empty((_MAX_GROUPS, 5)),
        numbers=np.empty(_MAX_GROUPS, np.int64),
        packet=np.empty(PACKET_SIZE),
        around=np.empty(9, np.int64),
        entries=np.zeros(9),
    )
    # For each row once: the poses of the rays of level 0, which most marked pixels have, and the
    # sweep of the camera.
    rows, few = band[1] - band[0], sampling.counts[0]
    poses, sweeps = np.empty((rows, few, POSE_SIZE)), np.empty((rows, POSE_SIZE))
    for row in range(band[0], band[1]):
        d, e = exposure_sweep(shutter, row)
        store_pose((d, e, 0.0), sweeps[row - band[0]])
        for k in range(few):
            phase = sampling.offsets[0, k, 2]
            store_pose(pose_at(shutter, rays.shape[0], row, phase), poses[row - band[0], k])
    for top in range(band[0], band[1], CULL_TILE):
        for left in range(0, rays.shape[1], CULL_TILE):
            tile = make_tile(rays, band, top, left, CULL_TILE)
            if not blur_tile(
                world,
                shutter,
                rays,
                tile,
                sweeps[top - band[0] :],
                view,
                sampling.counts,
                marks,
                image,
            ):
                continue
            # Solids of the large tile are culled once, and only if a pixel becomes UNCERTAIN.
            is_culled, culled = False, (0, np.inf)
            for upper in range(tile[0], tile[1], _TILE):
                for first in range(tile[2], tile[3], _TILE):
                    part = make_tile(rays, band, upper, first, _TILE)
                    if not has_marks(marks, part):
                        continue
                    candidates = Candidates(near[0][:0], near[1][:0], np.inf, 0.0)
                    for stage in (EDGE, UNCERTAIN):
                        if stage == UNCERTAIN:
                            if not is_culled:
                                culled = cull_solids(world, shutter, rays, tile, 0.5, far)
                                is_culled = True
                            count, entry, descent = cull_again(
                                world, shutter, rays, part, 0.5, far, culled, near
                            )
                            candidates = Candidates(
                                near[0][:count], near[1][:count], entry, descent
                            )
                        if supersample_tile(
                            world,
                            shutter,
                            rays,
                            part,
                            stage,
                            candidates,
                            sampling,
                            poses[upper - band[0] :],
                            sweeps[upper - band[0] :],
                            scratch,
                            view,
                            marks,
                            image,
                        ):
                            break


@inlined
def has_marks(marks: NDArray[np.uint8], tile: Tile) -> bool:
    """Whether any pixel of a tile is marked."""
    for row in range(tile[0], tile[1]):
        for column in range(tile[2], tile[3]):
            if marks[0, row, column] != 0:
                return True
    return False
