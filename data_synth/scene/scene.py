"""A world with the route through it and its moving bodies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.scene.world import World
from vo.base.types import Floats

Heights = Callable[[Floats], Floats]


def flat_ground(height_m: float = 0.0) -> Heights:
    """Heights of flat ground."""
    return lambda xy: np.full(len(xy), height_m)


@dataclass(frozen=True, eq=False)
class Course:
    """A closed route for cameras, with free space about it."""

    waypoints: Floats  # (K, 2) corners x, y of the closed route in metres, in order
    half_width_m: float  # free distance on both sides, also at corners
    head_room_m: float  # free height above the ground
    ground: Heights  # heights (N,) of the ground below points (N, 2)
    # usual direction of view of handheld cameras and drones, degrees to the left of ahead
    view_yaw_deg: float = 0.0
    # distance, to the left, of the way back in the other direction; None if it is within the half
    # width
    back_left_m: float | None = None


@dataclass(frozen=True, eq=False)
class Body:
    """A group of solids that moves as one, upright on the ground, facing ahead."""

    name: str  # `car 0`, `person 3`; unique in its world
    route: Floats  # (K, 2) corners x, y of its closed route, metres; it cuts them
    speed_m_s: float  # along the route; 0 for standing still
    start: float  # its position at time 0, as a fraction 0…1 of the route
    radius_m: float  # of an upright cylinder that contains it


@dataclass(frozen=True, eq=False)
class Scene:
    """A world to render. `bodies[i]` is body number i of `world`."""

    world: World
    course: Course
    bodies: tuple[Body, ...] = ()
