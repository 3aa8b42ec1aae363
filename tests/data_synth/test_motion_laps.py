from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from motion_courses import COURSES, walls

from data_synth.motion.limits import BOUNDS
from data_synth.motion.motions import make_path
from data_synth.motion.route import route_of_laps
from data_synth.motion.spline import PosePath
from data_synth.recipe import LapName
from vo.base.errors import ConfigError
from vo.base.types import Floats

SECONDS = {"ring": 90.0, "rectangle": 250.0, "aisles": 180.0}
THERE_AND_BACK: tuple[LapName, ...] = ("forward", "reverse")


@cache
def _path(course: str, laps: tuple[LapName, ...]) -> PosePath:
    where = COURSES[course]
    clearance = walls(where, where.half_width_m)
    return make_path("loop", where, clearance, seconds=SECONDS[course], laps=laps)


def _turned(path: PosePath) -> Floats:
    """Angle about the origin that the path has turned (N,), by the tenth of a second."""
    places = path.world_from_body(np.arange(0.0, path.duration_s, 0.1))[:, :2, 3]
    return np.unwrap(np.arctan2(places[:, 1], places[:, 0])) / (2.0 * np.pi)


def test_without_laps_the_route_is_that_of_the_course() -> None:
    corners = COURSES["aisles"].waypoints
    np.testing.assert_array_equal(route_of_laps(corners, (), 1.0), corners)


def test_forward_laps_repeat_the_corners_from_the_same_side() -> None:
    corners = COURSES["rectangle"].waypoints
    np.testing.assert_array_equal(
        route_of_laps(corners, ("forward", "forward"), 1.0), np.vstack([corners, corners])
    )


def test_laps_in_reverse_run_beside_the_forward_ones() -> None:
    corners = COURSES["rectangle"].waypoints
    route = route_of_laps(corners, THERE_AND_BACK, 4.0)
    assert len(route) == 2 * len(corners) + 4
    inner = [[71.0, -41.0], [-71.0, -41.0], [-71.0, 41.0], [71.0, 41.0]]
    at = [row.tolist() for row in route].index(inner[0])
    np.testing.assert_allclose(route[at : at + 4], inner)


def test_reverse_laps_go_round_the_other_way() -> None:
    turned = _turned(_path("rectangle", ("forward", "forward", "reverse")))
    assert turned.max() - turned[0] == pytest.approx(2.0, abs=0.05)
    assert turned[-1] - turned[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("course", SECONDS)
def test_laps_keep_within_the_bounds_and_off_the_walls(course: str) -> None:
    path, where, bounds = _path(course, THERE_AND_BACK), COURSES[course], BOUNDS["loop"]
    times = np.arange(0.0, path.duration_s, 0.02)
    poses = path.world_from_body(times)
    assert walls(where, where.half_width_m)(poses[:, :3, 3]).min() >= 0.24
    assert np.linalg.norm(path.angular_velocity(times), axis=1).max() < bounds.turn_rad_s
    acceleration = np.linalg.norm(path.acceleration(times), axis=1)
    assert acceleration.max() < bounds.acceleration_m_s2
    assert np.linalg.norm(poses[0, :3, 3] - poses[-1, :3, 3]) < 0.05


def test_laps_are_for_loops_only() -> None:
    with pytest.raises(ConfigError, match="laps are for motion loop, not for car"):
        make_path(
            "car",
            COURSES["rectangle"],
            lambda points: np.full(len(points), 9.0),
            seconds=10.0,
            laps=THERE_AND_BACK,
        )
