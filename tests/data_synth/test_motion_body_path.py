from __future__ import annotations

import numpy as np
import pytest
from motion_courses import COURSES

from data_synth.motion.body_path import poses_at
from data_synth.scene.scene import Body, flat_ground

SQUARE = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0]])
TIMES = np.arange(0.0, 60.0, 0.02)


def test_body_follows_its_route_at_constant_speed_facing_ahead() -> None:
    body = Body("person 0", SQUARE, 1.4, 0.25, 0.4)
    poses, velocities = poses_at(body, TIMES, flat_ground())
    np.testing.assert_allclose(np.linalg.norm(velocities, axis=1), 1.4, atol=1e-9)
    steps = np.diff(poses[:, :3, 3], axis=0) / 0.02
    np.testing.assert_allclose(steps, 0.5 * (velocities[1:] + velocities[:-1]), atol=0.02)
    np.testing.assert_allclose(poses[:, :3, 0] * 1.4, velocities, atol=1e-9)
    rotations = poses[:, :3, :3]
    np.testing.assert_allclose(
        np.swapaxes(rotations, 1, 2) @ rotations,
        np.tile(np.eye(3), (len(TIMES), 1, 1)),
        atol=1e-9,
    )


def test_body_turns_smoothly_and_cuts_corners_by_its_radius_at_most() -> None:
    poses, _ = poses_at(Body("car 0", SQUARE, 5.0, 0.0, 2.0), TIMES, flat_ground())
    yaw = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    assert np.abs(np.diff(yaw)).max() / 0.02 < 2.0
    nearest = [np.linalg.norm(poses[:, :2, 3] - corner, axis=1).min() for corner in SQUARE]
    assert min(nearest) > 0.5
    assert max(nearest) < 2.1


def test_body_stands_on_the_ground_and_rises_with_it() -> None:
    ground = COURSES["hills"].ground
    body = Body("car 1", 4.0 * SQUARE, 8.0, 0.5, 2.0)
    poses, velocities = poses_at(body, TIMES, ground)
    np.testing.assert_allclose(poses[:, 2, 3], ground(poses[:, :2, 3]), atol=1e-12)
    np.testing.assert_allclose(poses[:, 2, 2], 1.0)
    rise = np.gradient(poses[:, 2, 3], 0.02)
    np.testing.assert_allclose(velocities[5:-5, 2], rise[5:-5], atol=0.01)
    assert np.abs(rise).max() > 0.5


def test_body_without_speed_does_not_move() -> None:
    poses, velocities = poses_at(Body("car 2", SQUARE, 0.0, 0.6, 2.0), TIMES, flat_ground())
    assert np.ptp(poses, axis=0).max() == 0.0
    assert not velocities.any()
    there, _ = poses_at(Body("car 2", SQUARE, 0.0, 0.1, 2.0), TIMES[:1], flat_ground())
    assert np.linalg.norm(there[0, :3, 3] - poses[0, :3, 3]) > 5.0


def test_route_of_two_points_runs_there_and_back() -> None:
    there_and_back = Body("person 1", SQUARE[:2], 1.0, 0.0, 0.4)
    poses, _ = poses_at(there_and_back, TIMES, flat_ground())
    assert poses[:, 0, 3].max() == pytest.approx(20.0, abs=0.5)
    assert poses[:, 0, 3].min() == pytest.approx(0.0, abs=0.5)
    assert np.abs(poses[:, 1, 3]).max() < 0.5
