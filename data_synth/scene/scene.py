"""A world together with the ways through it and what moves in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.scene.world import World
from vo.types import Floats

Heights = Callable[[Floats], Floats]


def level(height_m: float = 0.0) -> Heights:
    """Ground of the same height everywhere."""
    return lambda xy: np.full(len(xy), height_m)


@dataclass(frozen=True, eq=False)
class Course:
    """Where a camera can go: a closed way with free space about it.

    Attributes:
        waypoints: (K, 2) corners x, y of the way in metres, in order; the last leads to the first.
        half_width_m: free distance on both sides of it, also at its corners.
        head_room_m: free height above the ground.
        ground: heights (N,) of the ground below points (N, 2).
        outlook: where handheld cameras and drones like to look, in degrees to the left of ahead.
    """

    waypoints: Floats
    half_width_m: float
    head_room_m: float
    ground: Heights
    outlook_deg: float = 0.0


@dataclass(frozen=True, eq=False)
class Body:
    """A group of solids that moves as one, standing on the ground, always looking ahead.

    Attributes:
        name: `car 0`, `person 3`; unique in its world.
        way: (K, 2) corners x, y of its closed way, metres; it rounds them.
        speed_m_s: along the way; 0 stands still.
        start: share of the way, 0…1, at which it is at time 0.
        radius_m: of the upright cylinder that holds it.
    """

    name: str
    way: Floats
    speed_m_s: float
    start: float
    radius_m: float


@dataclass(frozen=True, eq=False)
class Scene:
    """A world to film in. `bodies[i]` is body number i of `world`."""

    world: World
    course: Course
    bodies: tuple[Body, ...] = ()
