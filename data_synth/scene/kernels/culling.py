"""Solids that the rays of a tile may meet, in the order in which they may be met.

The tree is stored in depth-first order: the first child of a node is the next node, and `skip` is
the node after all its descendants. So a traversal is a loop with an index and needs no stack.
"""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.beams import box_entry_bound, entry_bound, tile_beam
from data_synth.scene.kernels.camera import pose_at
from data_synth.scene.kernels.decorators import entry_point, inlined
from data_synth.scene.kernels.ground import descent_end, ground_entry_bound
from data_synth.scene.kernels.records import Beam, SolidList, Tile
from data_synth.scene.kernels.vectors import add_scaled, maximum, minimum, subtract
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats, Ints


@entry_point
def empty_list(world: World) -> SolidList:
    """Room for a list of all solids."""
    return np.empty(len(world.kinds), np.int64), np.empty(len(world.kinds))


@inlined
def cull_solids(
    world: World, shutter: Shutter, rays: Floats, tile: Tile, phase: float, result: SolidList
) -> tuple[int, float]:
    """List the solids that any ray of a tile may meet at phases -phase…phase of the exposure.

    Returns their number, and the t before which no ray meets the ground.
    """
    beam = tile_beam(shutter, rays, tile, phase)
    if beam.ray_min[0] > beam.ray_max[0]:  # outside the image circle
        return 0, np.inf
    tree, (solids, entries) = world.tree, result
    node, count = 0, 0
    while node < len(tree.skip):
        near = box_entry_bound(tree.bounds, node, beam)
        if near == np.inf:
            node = tree.skip[node]
            continue
        if tree.solid[node] >= 0:
            count = insert_sorted(solids, entries, count, tree.solid[node], near)
        node += 1
    for mover in range(len(world.movers.bodies)):
        solid = len(world.bounds) + mover
        near = mover_entry_bound(world, shutter, rays.shape[0], tile, phase, solid, beam)
        if near != np.inf:
            count = insert_sorted(solids, entries, count, solid, near)
    return count, ground_entry_bound(world, beam, 0.0)


@inlined
def cull_again(
    world: World,
    shutter: Shutter,
    rays: Floats,
    tile: Tile,
    phase: float,
    listed: SolidList,
    culled: tuple[int, float],
    result: SolidList,
) -> tuple[int, float, float]:
    """Of the solids listed for a larger tile, list those that a smaller tile in it may meet.

    `culled` is the result of `cull_solids` for the larger one. Returns the number of solids, the t
    before which no ray meets the ground, and `descent_end`. They are not returned as `Candidates`,
    because inlined functions cannot return arrays.
    """
    beam = tile_beam(shutter, rays, tile, phase)
    if beam.ray_min[0] > beam.ray_max[0]:
        return 0, np.inf, 0.0
    solids, entries = result
    count = 0
    for k in range(culled[0]):
        solid, near = listed[0][k], listed[1][k]
        if solid < len(world.bounds):
            near = box_entry_bound(world.bounds, solid, beam)
        if near != np.inf:
            count = insert_sorted(solids, entries, count, solid, near)
    ground_entry = ground_entry_bound(world, beam, culled[1])
    return count, ground_entry, descent_end(world, beam, ground_entry)


@inlined
def insert_sorted(solids: Ints, entries: Floats, count: int, solid: int, near: float) -> int:
    """Insert a solid into a list of `count`, in ascending order of entries; returns the count."""
    at = count
    while at > 0 and entries[at - 1] > near:
        solids[at], entries[at] = solids[at - 1], entries[at - 1]
        at -= 1
    solids[at], entries[at] = solid, near
    return count + 1


@inlined
def mover_entry_bound(
    world: World,
    shutter: Shutter,
    rows: int,
    tile: Tile,
    phase: float,
    solid: int,
    beam: Beam,
) -> float:
    """As `entry_bound`, of a moving solid, over all its positions while a tile is exposed."""
    _, _, first = pose_at(shutter, rows, tile[0], -phase)
    _, _, last = pose_at(shutter, rows, tile[1] - 1, phase)
    shape, v = world.shapes[solid], world.movers.velocities[solid - len(world.bounds)]
    # Half size of the upright box around the turned solid
    cosine, sine = abs(shape[6]), abs(shape[7])
    reach = cosine * shape[3] + sine * shape[4], sine * shape[3] + cosine * shape[4], shape[5]
    velocity = (v[0], v[1], v[2])
    # In the frame of the solid, the origins move instead.
    origin_min = minimum(
        add_scaled(beam.origin_min, velocity, -first), add_scaled(beam.origin_min, velocity, -last)
    )
    origin_max = maximum(
        add_scaled(beam.origin_max, velocity, -first), add_scaled(beam.origin_max, velocity, -last)
    )
    centre = (shape[0], shape[1], shape[2])
    return entry_bound(
        subtract(centre, reach),
        add_scaled(centre, reach, 1.0),
        Beam(origin_min, origin_max, beam.ray_min, beam.ray_max),
    )
