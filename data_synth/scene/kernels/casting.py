"""First pass: one ray for each pixel, in the middle of the exposure of its row.

The result is sharp in time; `blur` and `supersampling` derive the mean over the exposure from it.
"""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.beams import make_tile
from data_synth.scene.kernels.camera import POSE_SIZE, load_pose, pose_at, store_pose, world_ray
from data_synth.scene.kernels.culling import cull_again, cull_solids, empty_list
from data_synth.scene.kernels.decorators import entry_point, inlined
from data_synth.scene.kernels.frames import ground_number
from data_synth.scene.kernels.packets import PACKET_SIZE, intersect_solids, nearest_hit, set_ray
from data_synth.scene.kernels.records import (
    CAST_TILE,
    CULL_TILE,
    FILTER_REUSE,
    LANES,
    NOTHING,
    SAME_DEPTH,
    Candidates,
    Tile,
    View,
)
from data_synth.scene.kernels.shading import choose_filter, has_uniform_filter, surface_radiance
from data_synth.scene.kernels.textures import NO_FILTER
from data_synth.scene.kernels.vectors import rotate
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats


@entry_point
def cast_rows(
    world: World, shutter: Shutter, rays: Floats, band: tuple[int, int], view: View
) -> None:
    """Fill in rows band[0]…band[1] - 1 of a view.

    Solids are culled twice: by the tree for tiles of CULL_TILE pixels, then from the resulting list
    for tiles of CAST_TILE in them, so that the tree is traversed once for many small tiles.
    """
    far, near, packet = empty_list(world), empty_list(world), np.empty(PACKET_SIZE)
    poses = np.empty((band[1] - band[0], POSE_SIZE))
    for row in range(band[0], band[1]):
        store_pose(pose_at(shutter, rays.shape[0], row, 0.0), poses[row - band[0]])
    for top in range(band[0], band[1], CULL_TILE):
        for left in range(0, rays.shape[1], CULL_TILE):
            tile = make_tile(rays, band, top, left, CULL_TILE)
            tile_poses = poses[tile[0] - band[0] :]
            culled = cull_solids(world, shutter, rays, tile, 0.0, far)
            for upper in range(tile[0], tile[1], CAST_TILE):
                for first in range(tile[2], tile[3], CAST_TILE):
                    part = make_tile(rays, band, upper, first, CAST_TILE)
                    count, entry, descent = cull_again(
                        world, shutter, rays, part, 0.0, far, culled, near
                    )
                    candidates = Candidates(near[0][:count], near[1][:count], entry, descent)
                    cast_tile(
                        world, tile_poses[upper - top :], rays, part, candidates, packet, view
                    )
            # In a loop of its own: together with the intersection, both take a sixth longer.
            shade_tile(world, tile_poses, rays, tile, view)


@inlined
def cast_tile(
    world: World,
    poses: Floats,
    rays: Floats,
    tile: Tile,
    candidates: Candidates,
    packet: Floats,
    view: View,
) -> None:
    """Set depth and surface of the pixels of a tile, which is at most LANES wide.

    `poses` are those of the rows of the tile. Each row is one packet.
    """
    guess, ground = candidates.ground_entry, ground_number(world)
    depth, surface = view.depth, view.surface
    for row in range(tile[0], tile[1]):
        rotation, start, time = load_pose(poses[row - tile[0]])
        for lane in range(LANES):
            column = min(tile[2] + lane, tile[3] - 1)
            x, y = rays[row, column, 0], rays[row, column, 1]
            set_ray(packet, lane, start, time, rotate(rotation, (x, y, 1.0)))
        intersect_solids(world, packet, candidates)
        for column in range(tile[2], tile[3]):
            if np.isnan(rays[row, column, 0]):
                depth[row, column], surface[row, column] = np.inf, NOTHING
                continue
            t, number = nearest_hit(world, packet, column - tile[2], candidates, guess)
            depth[row, column], surface[row, column] = t, number
            if number == ground:
                guess = t  # the next pixel probably sees the ground near this point


@inlined
def shade_tile(world: World, poses: Floats, rays: Floats, tile: Tile, view: View) -> None:
    """Set the radiance of the pixels of a tile from depth and surface.

    Neighbours in a row that see one surface at about one depth share a texture filter.
    """
    image, depth, surface = view
    filter_ = NO_FILTER
    for row in range(tile[0], tile[1]):
        rotation, start, time = load_pose(poses[row - tile[0]])
        same, first, until = NOTHING, 0.0, 0
        for column in range(tile[2], tile[3]):
            number = surface[row, column]
            if number == NOTHING:
                image[row, column] = 0.0
                continue
            t = float(depth[row, column])
            if number == same and column < until and abs(t - first) <= SAME_DEPTH * first:
                ray = rotate(rotation, (rays[row, column, 0], rays[row, column, 1], 1.0))
            else:
                ray, across, down = world_ray(rays, row, column, rotation)
                filter_ = choose_filter(world, start, time, ray, (across, down), t, number)
                same, first, until = number, t, column + FILTER_REUSE
                if not has_uniform_filter(world, number):
                    until = column
            image[row, column] = surface_radiance(world, start, time, ray, t, number, filter_)
