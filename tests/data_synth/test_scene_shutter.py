from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from room_walk import RIG, world_from_cam0
from scene_views import CAMERA, LEFT_HALF, WALL, bright_world, gliding, looking_along_x

from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import moving_shutter, static_shutter
from data_synth.scene.world import World

RAYS = camera_rays(CAMERA)
ROWS = CAMERA.height
DEPTH_M = 4.0


def test_rolling_shutter_shears_an_edge_by_speed_times_readout(pool: ThreadPoolExecutor) -> None:
    world = bright_world([LEFT_HALF, WALL])
    speed, readout = 10.0, 0.02  # to the left, so that the edge goes right: 5 px
    shutter = moving_shutter(gliding((0.0, speed, 0.0)), 0.0, ROWS, 0.0, readout)
    edges = render(world, RAYS, shutter, pool).image.sum(axis=1) - 0.5
    times = readout * (np.arange(ROWS) / (ROWS - 1) - 0.5)
    expected = CAMERA.cx + CAMERA.fx * speed * times / DEPTH_M
    assert np.abs(edges - expected).max() < 0.15
    slope = np.polyfit(np.arange(ROWS), edges, 1)[0] * (ROWS - 1)
    assert slope == pytest.approx(CAMERA.fx * speed * readout / DEPTH_M, rel=0.01)


@pytest.mark.parametrize("motion_px", [2.0, 7.3, 20.0])
def test_blurred_edge_is_as_wide_as_the_motion_and_unbiased(
    pool: ThreadPoolExecutor, motion_px: float
) -> None:
    world = bright_world([LEFT_HALF, WALL])
    exposure = 0.01
    speed = motion_px * DEPTH_M / CAMERA.fx / exposure
    sharp = render(world, RAYS, static_shutter(looking_along_x()), pool).image
    shutter = moving_shutter(gliding((0.0, speed, 0.0)), 0.0, ROWS, exposure)
    image = render(world, RAYS, shutter, pool).image
    assert abs(float((image.sum(axis=1) - sharp.sum(axis=1)).mean())) < 0.05
    assert np.abs(image.sum(axis=1) - sharp.sum(axis=1)).max() < 0.3
    # The deviation of the profile's slope is that of the motion and of a pixel.
    slope, middle = -np.diff(image.mean(axis=0)), np.arange(CAMERA.width - 1) + 0.5
    centre = float((slope * middle).sum())
    deviation = np.sqrt((slope * (middle - centre) ** 2).sum())
    assert np.sqrt(12.0 * deviation**2) == pytest.approx(np.sqrt(motion_px**2 + 2.0), rel=0.06)


def test_blurred_image_is_the_mean_of_many_sharp_ones(
    room: World, pool: ThreadPoolExecutor
) -> None:
    rays = camera_rays(RIG.cam0)[::2, ::2].copy()
    time_s, exposure = 2.2, 0.03
    times = time_s + exposure * ((np.arange(24) + 0.5) / 24 - 0.5)
    poses = world_from_cam0(times)
    expected = np.mean([render(room, rays, static_shutter(p), pool).image for p in poses], axis=0)
    shutter = moving_shutter(world_from_cam0, time_s, len(rays), exposure)
    error = render(room, rays, shutter, pool).image - expected
    sharp = render(room, rays, static_shutter(world_from_cam0(np.array([time_s]))[0]), pool).image
    assert float(np.sqrt(np.mean(error**2))) < 0.3 * float(
        np.sqrt(np.mean((sharp - expected) ** 2))
    )
    assert abs(float(error.mean())) < 1e-3
    assert float(np.quantile(np.abs(error), 0.99)) < 0.05


def test_depth_is_that_of_the_middle_of_the_exposure(room: World, pool: ThreadPoolExecutor) -> None:
    rays = camera_rays(RIG.cam0)[::4, ::4].copy()
    shutter = moving_shutter(world_from_cam0, 1.0, len(rays), 0.01)
    middle = static_shutter(world_from_cam0(np.array([1.0]))[0])
    blurred, sharp = (render(room, rays, s, pool).depth for s in (shutter, middle))
    assert np.mean(np.abs(blurred - sharp) > 1e-3 * sharp) < 1e-3


def test_number_of_threads_does_not_change_the_image(room: World) -> None:
    rays = camera_rays(RIG.cam0)[::3, ::3].copy()
    shutter = moving_shutter(world_from_cam0, 1.0, len(rays), 0.02, 0.02)
    images = []
    for threads in (1, 4):
        with ThreadPoolExecutor(threads) as pool:
            images.append(render(room, rays, shutter, pool).image.tobytes())
    assert images[0] == images[1]


def test_camera_is_static_without_exposure_time_and_readout() -> None:
    shutter = moving_shutter(gliding((1.0, 0.0, 0.0)), 2.0, ROWS, 0.0)
    assert shutter.origins.tolist() == [[2.0, 0.0, 0.0]]
    assert shutter.width == 0.0
