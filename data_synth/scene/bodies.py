"""Placement of moving bodies for one frame."""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.baking import light_movers
from data_synth.scene.world import World
from vo.base.types import Floats


def with_bodies(world: World, world_from_bodies: Floats, velocities: Floats) -> World:
    """The world with its moving bodies at given poses.

    `world`: its arrays are shared with the result, but for those of moving solids.
    `world_from_bodies`: (B, 4, 4) upright poses in the middle of the exposure of the image's middle
    row. `velocities`: (B, 3) metres per second; a body moves evenly during the exposure of an
    image.
    """
    movers = world.movers
    if len(movers.bodies) == 0:
        return world
    poses = np.asarray(world_from_bodies, dtype=np.float64)[movers.bodies]
    shapes = world.shapes.copy()
    moved = shapes[len(world.bounds) :]
    moved[:, :3] = np.einsum("kij,kj->ki", poses[:, :3, :3], movers.places[:, :3]) + poses[:, :3, 3]
    yaws = np.arctan2(poses[:, 1, 0], poses[:, 0, 0]) + movers.places[:, 3]
    moved[:, 6], moved[:, 7] = np.cos(yaws), np.sin(yaws)
    speeds = np.asarray(velocities, dtype=np.float64)[movers.bodies]
    lights = np.zeros((len(movers.bodies), 4))
    light_movers(world, np.ascontiguousarray(moved[:, :3]), lights)
    return world._replace(shapes=shapes, movers=movers._replace(velocities=speeds, lights=lights))
