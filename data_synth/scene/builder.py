"""Builder that collects the solids and textures of a world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from data_synth.scene.kernels.baking import light_movers
from data_synth.scene.solids import Ground, Kind, Solid
from data_synth.scene.world import World, build_world
from vo.base.types import Floats, Floats32


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


Rng = np.random.Generator
Painter = Callable[[Rng, tuple[int, int]], Floats32]

Point = tuple[float, float, float]

_SMALL = (512, 512)


@dataclass
class Builder:
    """Solids and textures added so far."""

    rng: Rng
    solids: list[Solid] = field(default_factory=list)
    textures: list[Floats32] = field(default_factory=list)
    movers: list[tuple[int, Solid]] = field(default_factory=list)
    ground: Ground | None = None

    def paint(self, painter: Painter, shape: tuple[int, int] = _SMALL) -> int:
        """Add a texture, whose sides are powers of two, and return its number."""
        self.textures.append(painter(self.rng, shape))
        return len(self.textures) - 1

    def add(
        self,
        centre: Point,
        size: Point,
        texture: int,
        yaw: float = 0.0,
        density: float | None = 260.0,
        kind: Kind = Kind.BOX,
        stain: float = 0.0,
        body: int | None = None,
    ) -> None:
        """Add a solid whose texture has a random offset.

        With the number of a body it is part of that moving body; centre and yaw are then relative
        to the origin of the body, which is on the ground with x ahead.
        """
        u, v = (0.0, 0.0) if density is None else self.rng.uniform(0, 512, 2)
        offset = (float(u), float(v))
        solid = Solid(centre, size, texture, yaw, density, offset, kind, stain)
        if body is None:
            self.solids.append(solid)
        else:
            self.movers.append((body, solid))

    def world(self) -> World:
        """The world as arrays, without light."""
        return build_world(self.solids, self.textures, self.ground, self.movers)


@dataclass(frozen=True)
class Place:
    """A pose on the floor, for objects with their back at y = 0 and their front towards -y."""

    x: float
    y: float
    yaw: float

    def at(self, x: float, y: float, z: float) -> Point:
        """A point of the frame of this place, in the world."""
        cosine, sine = np.cos(self.yaw), np.sin(self.yaw)
        return (
            float(self.x + cosine * x - sine * y),
            float(self.y + sine * x + cosine * y),
            z,
        )
