"""Paths through worlds: a route, the speeds that it allows, and the carrier of the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data_synth.motion.carriers import CARRIERS, Handling
from data_synth.motion.collisions import Clearance, Collision, find_collision
from data_synth.motion.limits import (
    LIMITS,
    Carrier,
    Limits,
    carrier_of,
    height_range_m,
    polygon_length_m,
)
from data_synth.motion.motion_profile import MotionProfile, make_profile, stationary_profile
from data_synth.motion.route import Route, beside, make_route, route_of_laps
from data_synth.motion.speed_profile import (
    Schedule,
    drive_on,
    loop_in_time,
    make_speed_profile,
    stop_and_go,
)
from data_synth.motion.spline import BODY_FROM_LOOKING_AHEAD, PosePath
from data_synth.recipe import LapName, MotionName
from data_synth.scene.scene import Course
from vo.base.errors import ConfigError
from vo.base.geometry.transforms import make_transform
from vo.base.types import Floats

_STEP_S = 0.05
_LEAD = 14  # controls before the start and after the end, for 0.6 s
_SMOOTHING_STEPS = 60

_TURN_RAD, _TURN_S = np.deg2rad(90.0), 0.57
_FREEDOMS = (1.0, 0.5, 0.25, 0.0)
_MIN_CUT_M = 0.06
_SEED_ROUTE, _SEED_SCHEDULE, _SEED_WANDER = 21, 22, 23


def mount(motion: MotionName, course: Course, *, level: bool = False) -> Floats:
    """body_from_cam0 (4, 4): looking ahead (drones: downward), a few cm off the body's origin.

    A camera that turns on the spot sits close to the axis. `level`: never downward, for a rig.
    """
    carrier = carrier_of(motion, course, polygon_length_m(course.waypoints))
    down_deg = 0.0 if level else {"drone": 30.0, "drone_indoors": 5.0}.get(carrier, 0.0)
    cosine, sine = np.cos(np.deg2rad(down_deg)), np.sin(np.deg2rad(down_deg))
    nose_down = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    lever = [0.01, 0.01, 0.0] if motion == "rotate" else [0.05, 0.06, 0.02]
    return make_transform(nose_down @ BODY_FROM_LOOKING_AHEAD, np.array(lever))


def moved_aside(course: Course, left_m: float) -> Course:
    """The course along a line to the left of its middle, or to the right below 0."""
    if left_m == 0.0:
        return course
    free_m = max(0.0, course.half_width_m - abs(left_m))
    return replace(course, waypoints=beside(course.waypoints, left_m), half_width_m=free_m)


def make_path(
    motion: MotionName,
    course: Course,
    clearance: Clearance,
    *,
    seconds: float,
    speed: float = 1.0,
    seed: int = 0,
    laps: Sequence[LapName] = (),
) -> PosePath:
    """Make a path through a course.

    Wander and the cutting of corners are reduced until the path is free of collisions.

    `course`: the route and the free space about it. `clearance`: distances (N,) of points (N, 3) to
    the nearest solid. `seconds`: duration. `speed`: 1 is usual. `laps`: directions of the laps of a
    loop; none for as many forward laps as fit.

    Raises:
        ConfigError: no path is free of collisions, a loop does not fit into the duration, or laps
            are given for another motion.
    """
    if laps and motion != "loop":
        raise ConfigError(f"laps are for motion loop, not for {motion}; choose motion loop")
    carrier = carrier_of(motion, course, polygon_length_m(course.waypoints))
    limits = LIMITS[carrier]

    def free_distance(points: Floats) -> Floats:
        # On slopes, the nearest point of the ground is not the one below.
        above = 0.7 * (points[:, 2] - course.ground(points[:, :2]))
        return np.minimum(clearance(points), above)

    collision: Collision | None = None
    for freedom in _FREEDOMS:
        path = _make_path(motion, carrier, course, freedom, seconds, speed, seed, laps)
        collision = find_collision(path, free_distance, limits.margin_m)
        if collision is None:
            return path
    raise ConfigError(f"{motion}: {_describe(collision, limits)}; choose another motion or world")


def looking_aside(path: PosePath, times: int, hold_s: float) -> PosePath:
    """The path with quick turns of the view: to the left and back, then to the right and back.

    The turning rate is that of a raised cosine, up to 300°/s. `times`: how often, at equal
    distances in time. `hold_s`: time for which the view stays aside.
    """
    if times == 0:
        return path
    at_s = (np.arange(len(path.controls)) - path.lead) * path.step_s
    aside = np.zeros(len(at_s))
    for number in range(times):
        middle_s = (number + 0.5) * path.duration_s / times
        for sign, start_s in ((1.0, -0.5 * hold_s - _TURN_S), (-1.0, 0.5 * hold_s)):
            done = np.clip((at_s - middle_s - start_s) / _TURN_S, 0.0, 1.0)
            side = sign * (-1.0) ** number
            aside += side * _TURN_RAD * (done - np.sin(2.0 * np.pi * done) / (2.0 * np.pi))
    controls = path.controls.copy()
    controls[:, 3] += aside
    return replace(path, controls=controls)


def _describe(collision: Collision | None, limits: Limits) -> str:
    assert collision is not None
    x, y, z = collision.point
    return (
        f"at {collision.time_s:.1f} s the path passes {collision.distance_m:.2f} m from a solid "
        f"at ({x:.2f}, {y:.2f}, {z:.2f}), but needs {limits.margin_m:g} m"
    )


def _make_path(
    motion: MotionName,
    carrier: Carrier,
    course: Course,
    freedom: float,
    seconds: float,
    speed: float,
    seed: int,
    laps: Sequence[LapName],
) -> PosePath:
    limits = LIMITS[carrier]
    route = _route(course, limits, freedom, seed, laps)
    before = _LEAD + _SMOOTHING_STEPS
    count = int(np.ceil(seconds / _STEP_S)) + 2 * before + 1
    times = np.arange(-before, count - before, dtype=np.float64) * _STEP_S
    profile = _profile(motion, route, limits, times, seconds, speed, seed)
    handling = Handling(
        rng=np.random.default_rng([seed, _SEED_WANDER]),
        freedom=freedom,
        heights_m=height_range_m(carrier, course.head_room_m),
        view_yaw=float(np.deg2rad(course.view_yaw_deg)),
        seconds=seconds,
        speed=speed,
        repeats=motion == "loop",
    )
    controls = CARRIERS[carrier](profile, handling)[_SMOOTHING_STEPS:-_SMOOTHING_STEPS]
    return PosePath(controls, _STEP_S, _LEAD, seconds)


def _route(
    course: Course, limits: Limits, freedom: float, seed: int, laps: Sequence[LapName]
) -> Route:
    spare = max(0.0, course.half_width_m - limits.margin_m)
    aside = 0.5 * spare if course.back_left_m is None else course.back_left_m
    return make_route(
        route_of_laps(course.waypoints, laps, aside),
        course.ground,
        cut_m=max(_MIN_CUT_M, min(limits.cut_m, 0.7 * spare) * freedom),
        weave_m=min(limits.weave_m, 0.2 * spare) * freedom,
        weave_length_m=limits.weave_length_m,
        level_m=limits.level_m,
        rng=np.random.default_rng([seed, _SEED_ROUTE]),
    )


def _profile(
    motion: MotionName,
    route: Route,
    limits: Limits,
    times: Floats,
    seconds: float,
    speed: float,
    seed: int,
) -> MotionProfile:
    rng = np.random.default_rng([seed, _SEED_SCHEDULE])
    if motion == "rotate":
        return stationary_profile(route, float(rng.uniform(0.0, route.length_m)), times)
    speed_profile = make_speed_profile(route, limits, speed)
    schedule: Schedule
    if motion == "loop":
        schedule = loop_in_time(speed_profile, seconds, limits.ease_s)
    elif motion == "stop_and_go":
        schedule = stop_and_go(speed_profile, seconds, limits.ease_s, rng)
    else:
        schedule = drive_on(speed_profile, seconds)
    return make_profile(route, schedule, times, limits.ease_s)
