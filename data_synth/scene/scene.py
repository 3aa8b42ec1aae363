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
    """A closed route for cameras, with free space about it.

    Attributes:
        waypoints: (K, 2) corners x, y of the closed route in metres, in order.
        half_width_m: free distance on both sides, also at corners.
        head_room_m: free height above the ground.
        ground: heights (N,) of the ground below points (N, 2).
        view_yaw_deg: usual direction of view of handheld cameras and drones, degrees to the left
            of ahead.
        back_left_m: distance, to the left, of the way back in the other direction; None if it is
            within the half width.
    """

    waypoints: Floats
    half_width_m: float
    head_room_m: float
    ground: Heights
    view_yaw_deg: float = 0.0
    back_left_m: float | None = None


@dataclass(frozen=True, eq=False)
class Body:
    """A group of solids that moves as one, upright on the ground, facing ahead.

    Attributes:
        name: `car 0`, `person 3`; unique in its world.
        route: (K, 2) corners x, y of its closed route, metres; it cuts them.
        speed_m_s: along the route; 0 for standing still.
        start: its position at time 0, as a fraction 0…1 of the route.
        radius_m: of an upright cylinder that contains it.
    """

    name: str
    route: Floats
    speed_m_s: float
    start: float
    radius_m: float


@dataclass(frozen=True, eq=False)
class Scene:
    """A world to render. `bodies[i]` is body number i of `world`."""

    world: World
    course: Course
    bodies: tuple[Body, ...] = ()
