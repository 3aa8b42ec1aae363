from __future__ import annotations

import numpy as np
import pytest

from data_synth.motion.spline import walk_around
from data_synth.scene.world import World, clearance
from data_synth.worlds.room import make_room

STEP_S = 1e-3


def _second_differences(seed: int, duration_s: float) -> np.ndarray:
    times = np.arange(-0.2, duration_s + 0.2, STEP_S)
    poses = walk_around(seed, duration_s).world_from_cam0(times)
    return np.diff(poses[:, :3, :].reshape(len(times), 12), n=2, axis=0) / STEP_S**2


@pytest.mark.parametrize("duration_s", [8.0, 20.0])
def test_acceleration_is_bounded_and_continuous_also_where_the_path_closes(
    duration_s: float,
) -> None:
    accelerations = _second_differences(0, duration_s)
    assert np.abs(accelerations).max() < 6.0
    assert np.abs(np.diff(accelerations, axis=0)).max() < 0.1


def test_path_comes_back_to_its_start() -> None:
    path = walk_around(3, 8.0)
    start, end = path.world_from_cam0(np.array([0.0, 8.0]))
    np.testing.assert_allclose(start, end, atol=1e-9)


def test_a_short_walk_is_no_faster() -> None:
    whole, part = (walk_around(0, d).world_from_cam0(np.array([0.0, 0.5])) for d in (8.0, 0.5))
    np.testing.assert_array_equal(whole, part)


def test_rotations_are_right_handed_and_orthonormal() -> None:
    rotations = walk_around(1, 8.0).world_from_cam0(np.linspace(0, 8, 50))[:, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.swapaxes(1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)


def test_speed_is_that_of_a_walk() -> None:
    positions = walk_around(0, 8.0).world_from_cam0(np.linspace(0, 8, 801))[:, :3, 3]
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert 6.0 < steps.sum() < 10.0
    assert steps.max() / 0.01 < 2.0


@pytest.mark.parametrize("seed", range(6))
def test_path_keeps_clear_of_every_box(room: World, seed: int) -> None:
    times = np.arange(0.0, 24.0, 0.05)
    world = room if seed == 0 else make_room(seed)
    assert clearance(world, walk_around(seed, 24.0).world_from_cam0(times)[:, :3, 3]).min() > 0.3
