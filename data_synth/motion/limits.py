"""Limits of speed and acceleration for planning, and bounds of the finished motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from data_synth.recipe import MotionName
from data_synth.scene.scene import Course
from vo.base.types import Floats

Carrier = Literal["car", "robot", "handheld", "drone", "drone_indoors", "rotate"]

LARGE_M = 200.0  # closed routes longer than this are for cars
HIGH_M = 20.0  # head room above which drones fly outdoors


@dataclass(frozen=True)
class Limits:
    """Limits for the plan of a route and of the speeds along it."""

    speed_m_s: float  # maximum, at speed 1
    lateral_m_s2: float  # across the route, in curves and over the ground's rises and dips
    tangential_m_s2: float
    turn_rad_s: float
    cut_m: float  # largest distance by which a corner is cut
    weave_m: float  # largest deviation to both sides
    weave_length_m: float  # usual wavelength of that deviation
    level_m: float  # length over which the heights of the ground are averaged
    margin_m: float  # minimum distance to solids
    ease_s: float  # time over which changes of speed are eased


@dataclass(frozen=True)
class Bounds:
    """Bounds of a finished path, wander, bob and bumps included."""

    speed_m_s: float  # at speed 1; proportional to the speed setting
    acceleration_m_s2: float  # of the body's origin, at any speed
    turn_rad_s: float  # angular velocity, at speed 1; at most proportional to the speed setting


LIMITS: dict[Carrier, Limits] = {
    "car": Limits(11.0, 3.0, 2.0, 1.0, 5.0, 0.3, 60.0, 4.0, 0.5, 1.2),
    "robot": Limits(1.2, 1.5, 0.6, 0.9, 0.12, 0.05, 6.0, 0.6, 0.25, 0.6),
    "handheld": Limits(1.3, 1.5, 0.8, 1.0, 0.6, 0.15, 7.0, 1.5, 0.25, 0.8),
    "drone": Limits(5.0, 1.5, 1.2, 0.8, 12.0, 2.0, 60.0, 60.0, 0.25, 1.2),
    "drone_indoors": Limits(2.0, 1.5, 1.0, 1.0, 0.8, 0.2, 8.0, 10.0, 0.25, 1.0),
    "rotate": Limits(0.0, 1.5, 0.8, 1.2, 0.6, 0.0, 7.0, 1.5, 0.25, 0.8),
}

BOUNDS: dict[MotionName, Bounds] = {
    "car": Bounds(11.5, 3.2, 1.0),
    "robot": Bounds(1.3, 1.2, 0.9),
    "handheld": Bounds(1.6, 3.5, 1.3),
    "drone": Bounds(6.0, 2.3, 1.3),
    "rotate": Bounds(0.05, 0.1, 1.1),
    "stop_and_go": Bounds(11.5, 3.2, 1.0),
    "loop": Bounds(11.5, 3.5, 1.3),
}


def carrier_of(motion: MotionName, course: Course, length_m: float) -> Carrier:
    """The carrier of the camera, which for some motions depends on the course."""
    if motion == "drone" and course.head_room_m <= HIGH_M:
        return "drone_indoors"
    if motion == "loop" and course.head_room_m > HIGH_M:
        return "drone"
    if motion == "loop":
        return "car" if length_m > LARGE_M else "handheld"
    if motion == "stop_and_go":
        return "car" if length_m > LARGE_M else "robot"
    return motion


def height_range_m(carrier: Carrier, head_room_m: float) -> tuple[float, float]:
    """Lowest and highest height of the camera above the levelled ground."""
    if carrier == "drone":
        return 15.0, max(16.0, min(35.0, 0.9 * head_room_m))
    if carrier == "drone_indoors":
        return 0.8, min(max(2.0, 0.4 * head_room_m), max(0.9, head_room_m - 0.5))
    height = {"car": 1.6, "robot": 0.5, "handheld": 1.5, "rotate": 1.5}[carrier]
    return height, height


def polygon_length_m(waypoints: Floats) -> float:
    """Length of a closed route before its corners are rounded."""
    sides = np.roll(waypoints, -1, axis=0) - waypoints
    return float(np.linalg.norm(sides, axis=1).sum())
