"""Small worlds of known radiance and cameras on straight lines, for tests of the renderer."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from data_synth.scene.solids import Ground, Solid
from data_synth.scene.world import World, build_world
from vo.base.geometry.transforms import make_transform
from vo.base.types import Camera, Floats

BLACK, WHITE = 0, 1
CAMERA = Camera(120, 80, 100.0, 100.0, 59.5, 39.5)
WALL = Solid((20.5, 0.0, 0.0), (1.0, 100.0, 100.0), BLACK)  # behind all, seen along x
LEFT_HALF = Solid((4.0005, 5.0, 0.0), (0.001, 10.0, 20.0), WHITE)  # its edge is at y = 0, 4 m ahead
ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def bright_world(
    solids: Sequence[Solid],
    ground: Ground | None = None,
    movers: Sequence[tuple[int, Solid]] = (),
) -> World:
    """A world whose textures are black and white, and which is lit evenly: radiance 0 or 1."""
    textures = [np.zeros((4, 4), np.float32), np.ones((4, 4), np.float32)]
    world = build_world(solids, textures, ground, movers)
    lights = world.lights._replace(values=np.ones_like(world.lights.values))
    height_field = world.height_field._replace(light=np.ones_like(world.height_field.light))
    return world._replace(lights=lights, height_field=height_field)


def looking_along_x(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Floats:
    """The pose of a camera at a point that looks along x with z up."""
    return make_transform(ALONG_X, np.array([x, y, z]))


def gliding(speed: tuple[float, float, float]) -> Callable[[Floats], Floats]:
    """Poses of a camera that looks along x and passes the origin at time 0 at even speed."""
    return lambda times: np.array([looking_along_x(*(t * s for s in speed)) for t in times])


def points_seen(rays: Floats, depth: Floats, pose: Floats) -> Floats:
    """Points (N, 3) in the world of all pixels with finite depth."""
    seen = np.isfinite(depth)
    return (rays[seen] * depth[seen][:, None]) @ pose[:3, :3].T + pose[:3, 3]
