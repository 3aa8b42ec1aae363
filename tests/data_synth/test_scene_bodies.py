from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scene_views import CAMERA, WALL, WHITE, bright_world, gliding, looking_along_x

from data_synth.scene.builder import with_bodies
from data_synth.scene.lighting import bake_lighting
from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import moving_shutter, static_shutter
from data_synth.scene.solids import Lighting, Solid
from data_synth.scene.world import World
from vo.base.types import Floats

RAYS = camera_rays(CAMERA)
ROWS = CAMERA.height
CART = Solid((0.0, 0.0, 1.0), (6.0, 0.001, 2.0), WHITE)  # relative to its body
STILL = np.zeros((1, 3))
AT_REST = gliding((0.0, 0.0, 0.0))


def _at(x: float, y: float, yaw: float) -> Floats:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = (x, y, -1.0)
    return pose[None]


def _world(velocity: Floats, yaw: float = np.pi / 2) -> World:
    """The cart's right edge is at y = 0, and its side 4 m ahead of a camera at the origin."""
    world = with_bodies(bright_world([WALL], movers=[(0, CART)]), _at(4.0005, 3.0, yaw), velocity)
    lights = np.array([[0.0, 0.0, 0.0, 1.25]])  # radiance 1 on upright faces
    return world._replace(movers=world.movers._replace(lights=lights))


def test_body_is_rendered_at_its_pose(pool: ThreadPoolExecutor) -> None:
    depth = render(_world(STILL), RAYS, static_shutter(looking_along_x()), pool).depth
    assert depth[39, 30] == pytest.approx(4.0, abs=1e-6)
    assert depth[39, 80] == pytest.approx(20.0, abs=1e-5)
    turned = render(_world(STILL, yaw=0.0), RAYS, static_shutter(looking_along_x()), pool).depth
    # Now it stands along x, 3 m to the left.
    assert turned[39, 5] == pytest.approx(3.0 / -RAYS[39, 5, 0], rel=1e-3)
    assert turned[39, 30] == pytest.approx(20.0, abs=1e-5)


def test_rolling_shutter_shears_a_moving_body_by_speed_times_readout(
    pool: ThreadPoolExecutor,
) -> None:
    speed, readout = -8.0, 0.02  # to the right: 4 px
    world = _world(np.array([[0.0, speed, 0.0]]))
    image = render(world, RAYS, moving_shutter(AT_REST, 0.0, ROWS, 0.0, readout), pool).image
    rows = np.arange(18, 62)
    edges = image[18:62].sum(axis=1) - 0.5
    times = readout * (rows / (ROWS - 1) - 0.5)
    expected = CAMERA.cx - CAMERA.fx * speed * times / 4.0
    assert np.abs(edges - expected).max() < 0.15


def test_edge_of_a_moving_body_is_blurred_by_its_motion_and_unbiased(
    pool: ThreadPoolExecutor,
) -> None:
    exposure, motion_px = 0.01, 9.0
    speed = -motion_px * 4.0 / CAMERA.fx / exposure
    world = _world(np.array([[0.0, speed, 0.0]]))
    image = render(world, RAYS, moving_shutter(AT_REST, 0.0, ROWS, exposure), pool).image[20:60]
    sharp = render(world, RAYS, static_shutter(looking_along_x()), pool).image[20:60]
    assert abs(float((image.sum(axis=1) - sharp.sum(axis=1)).mean())) < 0.05
    between = (image > 0.01) & (image < 0.99)
    assert between.sum(axis=1).mean() == pytest.approx(motion_px, abs=1.5)


def test_body_is_darker_in_the_shade_than_in_the_sun() -> None:
    roof = Solid((50.0, 0.0, 5.0), (20.0, 20.0, 0.2), WHITE)
    world = bright_world([roof], movers=[(0, CART)])
    world = bake_lighting(
        world, Lighting(sun=(0.0, 0.0, 1.0), sun_power=0.5, ambient=0.4, points_per_m=0.5)
    )
    sunny, shady = (
        with_bodies(world, _at(x, 0.0, 0.0), STILL).movers.lights[0] for x in (0.0, 50.0)
    )
    assert sunny[2] == pytest.approx(0.5) and sunny[3] == pytest.approx(0.4)
    assert np.abs(shady[:3]).max() < 0.05


def test_world_without_bodies_is_unchanged() -> None:
    world = bright_world([WALL])
    assert with_bodies(world, np.zeros((0, 4, 4)), np.zeros((0, 3))) is world
