from __future__ import annotations

from functools import cache
from typing import get_args

import numpy as np
import pytest
from motion_courses import COURSES, LOOP_S, walls

from data_synth.motion.limits import BOUNDS, LARGE_M, polygon_length_m
from data_synth.motion.motions import looking_aside, make_path, mount, moved_aside
from data_synth.motion.spline import PosePath
from data_synth.recipe import MotionName
from vo.base.errors import ConfigError
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats

MOTIONS: tuple[MotionName, ...] = get_args(MotionName)
SECONDS = 30.0


@cache
def _path(motion: MotionName, course: str, speed: float = 1.0, seed: int = 0) -> PosePath:
    where = COURSES[course]
    return make_path(
        motion,
        where,
        walls(where, where.half_width_m),
        seconds=LOOP_S[course] if motion == "loop" else SECONDS,
        speed=speed,
        seed=seed,
    )


def _times(path: PosePath) -> Floats:
    return np.arange(-0.2, path.duration_s + 0.2, 0.01)


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("motion", MOTIONS)
def test_speed_acceleration_and_turning_keep_within_the_bounds(
    motion: MotionName, course: str
) -> None:
    path, bounds = _path(motion, course), BOUNDS[motion]
    times = _times(path)
    for values, bound in (
        (path.velocity(times), bounds.speed_m_s),
        (path.acceleration(times), bounds.acceleration_m_s2),
        (path.angular_velocity(times), bounds.turn_rad_s),
    ):
        assert np.linalg.norm(values, axis=1).max() < bound


@pytest.mark.parametrize("motion", MOTIONS)
def test_acceleration_is_bounded_at_three_times_the_speed(motion: MotionName) -> None:
    path, bounds = _path(motion, "hills", speed=3.0, seed=1), BOUNDS[motion]
    speeds = np.linalg.norm(path.velocity(_times(path)), axis=1)
    turns = np.linalg.norm(path.angular_velocity(_times(path)), axis=1)
    assert turns.max() < 3.0 * bounds.turn_rad_s
    assert np.linalg.norm(path.acceleration(_times(path)), axis=1).max() < bounds.acceleration_m_s2
    assert speeds.max() < 3.0 * bounds.speed_m_s


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("motion", MOTIONS)
def test_path_keeps_its_distance_from_walls_and_ground(motion: MotionName, course: str) -> None:
    path, where = _path(motion, course), COURSES[course]
    places = path.world_from_body(_times(path))[:, :3, 3]
    assert walls(where, where.half_width_m)(places).min() >= 0.24
    assert (places[:, 2] - where.ground(places[:, :2])).min() > 0.4


@pytest.mark.parametrize("course", COURSES)
def test_distance_travelled_suits_the_motion(course: str) -> None:
    gone = {}
    for motion in MOTIONS:
        path = _path(motion, course)
        gone[motion] = np.linalg.norm(path.velocity(_times(path)), axis=1).mean() * SECONDS
    assert gone["rotate"] < 1.0
    assert min(gone[m] for m in ("car", "robot", "handheld", "drone")) > 20.0
    assert gone["stop_and_go"] > 5.0
    assert gone["loop"] > 15.0


@pytest.mark.parametrize("motion", MOTIONS)
def test_path_depends_on_the_seed_only(motion: MotionName) -> None:
    first = _path(motion, "ring")
    again = make_path(
        motion,
        COURSES["ring"],
        walls(COURSES["ring"], COURSES["ring"].half_width_m),
        seconds=first.duration_s,
        seed=0,
    )
    np.testing.assert_array_equal(first.controls, again.controls)
    assert np.abs(first.controls - _path(motion, "ring", seed=1).controls).max() > 1e-4


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("seed", range(3))
def test_loop_ends_at_its_start_after_the_duration(course: str, seed: int) -> None:
    path = _path("loop", course, seed=seed)
    start, end = path.world_from_body(np.array([0.0, path.duration_s]))
    assert np.linalg.norm(start[:3, 3] - end[:3, 3]) < 0.02
    turned = inverse(start)[:3, :3] @ end[:3, :3]
    assert np.rad2deg(np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))) < 1.0
    places = path.world_from_body(np.linspace(0.0, path.duration_s, 4000))[:, :3, 3]
    for corner in COURSES[course].waypoints:  # it passes all corners
        nearest = np.linalg.norm(places[:, :2] - corner, axis=1).min()
        assert nearest < max(1.0, 0.8 * COURSES[course].half_width_m)


def test_long_loop_has_several_laps_at_about_the_usual_speed() -> None:
    path = make_path("loop", COURSES["ring"], lambda p: np.full(len(p), 9.0), seconds=100.0)
    yaw_rates = path.angular_velocity(np.arange(0.0, 100.0, 0.01))[:, 2]  # pitch and roll are small
    laps = yaw_rates.sum() * 0.01 / (2.0 * np.pi)
    assert laps == pytest.approx(round(laps), abs=0.1)
    assert laps > 7.5
    assert np.median(np.linalg.norm(path.velocity(np.arange(0, 100, 0.1)), axis=1)) > 0.8


def test_error_of_a_loop_that_does_not_fit_contains_its_duration() -> None:
    free = lambda p: np.full(len(p), 9.0)  # noqa: E731
    with pytest.raises(
        ConfigError, match=r"loop of 1\d m takes \d+\.\d s.*; 3 s are too short"
    ) as e:
        make_path("loop", COURSES["ring"], free, seconds=3.0)
    least = float(str(e.value).split("takes ")[1].split(" s")[0])
    assert make_path("loop", COURSES["ring"], free, seconds=least + 0.1).duration_s > least


@pytest.mark.parametrize("course", COURSES)
def test_rotate_makes_full_turns_and_back_almost_on_the_spot(course: str) -> None:
    path = _path("rotate", course)
    times = _times(path)
    yaw = path.controls[:, 3]
    assert np.rad2deg(yaw.max() - yaw.min()) == pytest.approx(360.0, abs=10.0)
    places = path.world_from_body(times) @ mount("rotate", COURSES[course])
    assert np.ptp(places[:, :3, 3], axis=0).max() < 0.08
    assert np.linalg.norm(path.velocity(times), axis=1).max() < 0.05
    pitch = path.controls[:, 4]
    assert np.rad2deg(pitch.max() - pitch.min()) > 10.0


def _runs(still: np.ndarray) -> list[int]:
    """Lengths of the stretches that are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return [int(n) for n in edges[1::2] - edges[::2]]


@pytest.mark.parametrize("seconds", [15.0, 60.0])
@pytest.mark.parametrize("course", COURSES)
def test_stop_and_go_stops_and_reverses_once(course: str, seconds: float) -> None:
    path = make_path(
        "stop_and_go", COURSES[course], lambda p: np.full(len(p), 9.0), seconds=seconds, seed=4
    )
    times = np.arange(0.0, seconds, 0.01)
    velocity = path.velocity(times)
    stops = [n for n in _runs(np.linalg.norm(velocity, axis=1) < 0.01) if n > 100]
    assert len(stops) >= 2
    assert max(stops) < 450
    ahead = (path.world_from_body(times)[:, :3, 0] * velocity).sum(axis=1)
    if seconds > 20.0:
        assert len([n for n in _runs(ahead < -0.01) if n > 50]) == 1


def test_direction_of_view_suits_the_motion() -> None:
    for motion, off_deg in (("robot", 0.0), ("handheld", 60.0), ("drone", 60.0)):
        path = _path(motion, "ring")
        times = np.arange(5.0, 30.0, 0.1)
        velocity, ahead = path.velocity(times), path.world_from_body(times)[:, :3, 0]
        cross = velocity[:, 0] * ahead[:, 1] - velocity[:, 1] * ahead[:, 0]
        angle = np.arctan2(cross, (velocity[:, :2] * ahead[:, :2]).sum(axis=1))
        assert np.rad2deg(np.median(angle)) == pytest.approx(off_deg, abs=8.0)


def test_cars_lean_little_and_drones_bank_into_their_curves() -> None:
    car = _path("car", "rectangle").controls
    assert np.rad2deg(np.abs(car[:, 4:])).max() < 0.5
    drone = _path("drone", "hills", seed=2)
    times = np.arange(0.0, 30.0, 0.02)
    rolls = np.arcsin(drone.world_from_body(times)[:, 2, 1])
    left = (drone.world_from_body(times)[:, :3, 1] * drone.acceleration(times)).sum(axis=1)
    assert np.corrcoef(rolls, left)[0, 1] < -0.8


def test_camera_heights_suit_the_carrier() -> None:
    heights = {}
    for motion in MOTIONS:
        path = _path(motion, "hills" if motion == "drone" else "rectangle")
        places = path.world_from_body(_times(path))[:, :3, 3]
        above = places[:, 2] - COURSES["hills" if motion == "drone" else "rectangle"].ground(
            places[:, :2]
        )
        heights[motion] = above
    assert np.ptp(heights["car"]) < 0.02
    assert heights["car"].mean() == pytest.approx(1.6, abs=0.01)
    assert heights["robot"].mean() == pytest.approx(0.5, abs=0.01)
    assert 0.03 < np.ptp(heights["handheld"]) < 0.3
    assert 10.0 < heights["drone"].min() < heights["drone"].max() < 40.0


def test_cam0_looks_ahead_and_drones_look_down() -> None:
    for motion, course, down_deg in (
        ("car", "hills", 0.0),
        ("drone", "hills", 30.0),
        ("drone", "ring", 5.0),
    ):
        body_from_cam0 = mount(motion, COURSES[course])
        looks = body_from_cam0[:3, 2]
        assert np.rad2deg(np.arctan2(-looks[2], looks[0])) == pytest.approx(down_deg)
        np.testing.assert_allclose(body_from_cam0[:3, 0], [0.0, -1.0, 0.0], atol=1e-12)
        assert np.linalg.norm(body_from_cam0[:3, 3]) < 0.1


def test_narrow_courses_reduce_wander_and_blocked_ones_are_refused() -> None:
    course = COURSES["aisles"]
    path = make_path("handheld", course, walls(course, 0.45), seconds=30.0)
    places = path.world_from_body(_times(path))[:, :3, 3]
    assert walls(course, 0.45)(places).min() >= 0.24
    with pytest.raises(ConfigError, match=r"0\.\d\d m from a solid at \(.*needs 0\.5 m"):
        make_path("car", course, walls(course, 0.4), seconds=30.0)


def test_small_obstacle_on_the_path_is_found() -> None:
    post = np.array([20.0, 7.0])  # in the middle of a side
    with pytest.raises(ConfigError, match=r"at \((19|20)\.\d+, [67]\.\d+, "):
        make_path(
            "robot",
            COURSES["aisles"],
            lambda p: np.maximum(np.linalg.norm(p[:, :2] - post, axis=1) - 0.01, 0.0),
            seconds=60.0,
        )


def test_loops_are_driven_on_long_courses_and_walked_on_short_ones() -> None:
    assert polygon_length_m(COURSES["aisles"].waypoints) < LARGE_M
    assert polygon_length_m(COURSES["rectangle"].waypoints) == pytest.approx(480.0)
    assert _path("loop", "rectangle").controls[:, 2].mean() == pytest.approx(1.6, abs=0.01)
    assert _path("loop", "aisles").controls[:, 2].mean() == pytest.approx(1.5, abs=0.05)


def test_view_turns_aside_and_back_at_300_degrees_per_second() -> None:
    path = _path("handheld", "ring")
    turned = looking_aside(path, 2, 3.0)
    times = np.arange(0.0, SECONDS, 0.01)
    assert np.array_equal(
        turned.world_from_body(times)[:, :3, 3], path.world_from_body(times)[:, :3, 3]
    )
    plain, quick = (np.degrees(p.angular_velocity(times)[:, 2]) for p in (path, turned))
    assert 285.0 < np.abs(quick - plain).max() < 315.0
    ahead, aside = (
        p.world_from_body(np.array([0.0, 7.5, 15.0, 22.5]))[:, :3, 0] for p in (path, turned)
    )
    assert np.allclose((ahead * aside).sum(axis=1), [1.0, 0.0, 1.0, 0.0], atol=0.03)
    side = np.cross(ahead, aside)[:, 2]
    assert side[1] > 0.9 and side[3] < -0.9
    assert looking_aside(path, 0, 1.0) is path


@pytest.mark.parametrize("left_m", [1.15, -1.15])
def test_a_path_aside_of_the_middle_is_along_the_wall(left_m: float) -> None:
    where = COURSES["aisles"]
    free = walls(where, where.half_width_m)
    path = make_path("robot", moved_aside(where, left_m), free, seconds=SECONDS)
    times = np.arange(0.0, SECONDS, 0.1)
    middle = _path("robot", "aisles")
    near, far = (free(each.world_from_body(times)[:, :3, 3]) for each in (path, middle))
    assert 0.25 < np.median(near) < 0.4 and np.median(far) > 1.0
    with pytest.raises(ConfigError, match="the path passes"):
        make_path("robot", moved_aside(where, 1.2 * left_m), free, seconds=SECONDS)
    assert moved_aside(where, 0.0) is where
