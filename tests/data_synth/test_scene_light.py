from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scene_views import CAMERA, WHITE, bright_world

from data_synth.scene.lighting import bake_lighting
from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import static_shutter
from data_synth.scene.solids import Ground, Kind, Lamp, Lighting, Solid
from data_synth.scene.world import World
from vo.base.types import Floats, Floats32

RAYS = camera_rays(CAMERA)
FLOOR = Solid((0.0, 0.0, -0.5), (30.0, 30.0, 1.0), WHITE)
POST = Solid((0.0, 0.0, 1.0), (1.0, 1.0, 2.0), WHITE)
SUN = Lighting(sun=(-1.0, 0.0, 1.0), sun_power=0.6, ambient=0.3, points_per_m=8.0)
HEIGHT_M = 20.0


def _from_above(world: World, pool: ThreadPoolExecutor) -> Floats32:
    """The view straight down from 20 m, u along x: 5 pixels to a metre on z = 0."""
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = (0.0, 0.0, HEIGHT_M)
    return render(world, RAYS, static_shutter(pose), pool).image


def _at(image: Floats32, x: float, y: float) -> float:
    u = CAMERA.cx + CAMERA.fx * x / HEIGHT_M
    v = CAMERA.cy - CAMERA.fy * y / HEIGHT_M
    return float(image[round(v), round(u)])


@pytest.mark.parametrize("ground", [False, True])
def test_length_of_a_shadow_follows_the_elevation_of_the_sun(
    pool: ThreadPoolExecutor, ground: bool
) -> None:
    flat = Ground(np.zeros((31, 31), np.float32), (-15.0, -15.0), 1.0, WHITE, stain=0.0)
    world = bright_world([POST], flat) if ground else bright_world([FLOOR, POST])
    image = _from_above(bake_lighting(world, SUN), pool)
    sunny, shady = _at(image, -3.0, 0.0), _at(image, 1.7, 0.0)  # 2 m high, so up to x = 2.5
    assert sunny == pytest.approx(0.3 * 1.1 + 0.6 * np.sqrt(0.5), abs=0.03)
    assert shady == pytest.approx(0.3 * 1.1, abs=0.05)
    assert _at(image, 2.1, 0.0) < 0.5 and _at(image, 3.0, 0.0) > 0.65
    assert _at(image, 1.7, 1.5) > 0.65


def test_hill_casts_a_shadow_on_the_valley_behind_it(pool: ThreadPoolExecutor) -> None:
    x = np.arange(-15.0, 16.0)
    profile = 4.0 * np.exp(-0.5 * (x / 1.5) ** 2)
    hill = Ground(np.tile(profile, (31, 1)).astype(np.float32), (-15.0, -15.0), 1.0, WHITE)
    low_sun = Lighting(sun=(-1.0, 0.0, 0.4), sun_power=0.6, ambient=0.3, points_per_m=1.0)
    light = bake_lighting(bright_world([], hill), low_sun).height_field.light[15]
    assert light[15 + 6] < 0.36 < 0.45 < light[15 - 8]


def test_shading_of_a_sphere_is_smooth_and_follows_its_normal(pool: ThreadPoolExecutor) -> None:
    ball = Solid((0.0, 0.0, 12.0), (8.0, 8.0, 8.0), WHITE, kind=Kind.ELLIPSOID)
    image = _from_above(bake_lighting(bright_world([ball]), SUN), pool)
    row = image[39, 20:100].astype(float)  # within the ball
    assert np.abs(np.diff(row)).max() < 0.04
    assert row[10] > row[40] > row[70] + 0.1  # from the sunny side to the other


def test_lamps_light_visible_surfaces_only(pool: ThreadPoolExecutor) -> None:
    table = Solid((0.0, 0.0, 1.0), (2.0, 2.0, 0.1), WHITE)
    lamps = (Lamp((0.0, 0.0, 2.5)), Lamp((-8.0, 0.0, 2.5)))
    world = bake_lighting(bright_world([FLOOR, table]), Lighting(lamps=lamps, points_per_m=4.0))
    image = _from_above(world, pool)
    assert _at(image, 0.0, 0.0) > 1.1  # the table's top
    assert _at(image, -8.0, 0.0) > 1.0
    only = bake_lighting(bright_world([FLOOR, table]), Lighting(lamps=lamps[:1], points_per_m=4.0))
    assert _at(_from_above(only, pool), -8.0, 0.0) < _at(image, -8.0, 0.0) - 0.3


def test_sky_is_paler_at_the_horizon_and_has_soft_clouds(pool: ThreadPoolExecutor) -> None:
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    world = bake_lighting(bright_world([Solid((0, 0, -99), (1, 1, 1), WHITE)]), Lighting(sky=0.6))
    image = render(world, RAYS, static_shutter(pose), pool).image
    assert image[38].mean() > image[0].mean() + 0.03
    assert image[0].std() > 0.003
    steps: Floats = np.abs(np.diff(image[:38].astype(float), axis=1))
    assert steps.max() < 0.06  # nothing for a corner detector
