from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scene_views import ALONG_X, CAMERA, WHITE, bright_world, points_seen

from data_synth.scene.height_field import heights_at
from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import static_shutter
from data_synth.scene.solids import Ground
from data_synth.scene.world import clearance, soft_noise
from vo.base.geometry.transforms import make_transform

RAYS = camera_rays(CAMERA)
HILLS = Ground(
    (25.0 * soft_noise(128, 2.0, 1)).astype(np.float32), (-100.0, -120.0), 1.7, WHITE, stain=0.0
)


def test_depth_is_that_of_the_first_hill_on_each_ray(pool: ThreadPoolExecutor) -> None:
    world = bright_world([], HILLS)
    top = float(heights_at(world.height_field, np.zeros((1, 2)))[0])
    for height, pitch in ((2.0, 0.0), (30.0, 0.9)):
        turn = np.array(
            [[1, 0, 0], [0, np.cos(pitch), np.sin(pitch)], [0, -np.sin(pitch), np.cos(pitch)]]
        )
        pose = make_transform(ALONG_X @ turn, np.array([0.0, 0.0, top + height]))
        depth = render(world, RAYS, static_shutter(pose), pool).depth.astype(float)
        seen = np.isfinite(depth)
        assert seen.mean() > (0.4 if pitch == 0.0 else 0.95)
        points = points_seen(RAYS, depth, pose)
        np.testing.assert_allclose(points[:, 2], heights_at(world.height_field, points), atol=2e-4)
        for fraction in np.linspace(0.02, 0.995, 120):  # nothing is in between
            between = pose[:3, 3] + fraction * (points - pose[:3, 3])
            assert (between[:, 2] - heights_at(world.height_field, between)).min() > -1e-4


def test_no_slope_of_the_ground_is_steeper_than_its_bound() -> None:
    height_field = bright_world([], HILLS).height_field
    cells = np.array(height_field.heights.shape) - 1
    rng = np.random.default_rng(5)
    cell = rng.integers(0, cells[::-1], (4000, 2))
    at = height_field.corner + height_field.cell * (cell + rng.uniform(0.01, 0.99, (4000, 2)))
    turn, step = rng.uniform(0.0, 2.0 * np.pi, 4000), 1e-4
    ahead = at + step * np.column_stack([np.cos(turn), np.sin(turn)])
    slopes = np.abs(heights_at(height_field, ahead) - heights_at(height_field, at)) / step
    bounds = height_field.slopes[: cells.prod()].reshape(cells)[cell[:, 1], cell[:, 0]]
    assert (slopes - bounds).max() < 1e-6
    # The bounds are tight enough that descents of rays can often be proven.
    assert (slopes > 0.9 * bounds)[bounds > 0.1].mean() > 0.05
    assert height_field.slopes[-1] == height_field.slopes.max()


def test_rays_along_grid_lines_hit_the_ground(pool: ThreadPoolExecutor) -> None:
    world = bright_world([], HILLS)
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])  # straight down, along the lines of the grid
    pose[:3, 3] = (-100.0 + 1.7 * 50, -120.0 + 1.7 * 50, 40.0)
    assert np.isfinite(render(world, RAYS, static_shutter(pose), pool).depth).all()


def test_crest_of_a_near_hill_is_antialiased_and_unbiased(pool: ThreadPoolExecutor) -> None:
    x = np.arange(101.0)
    profile = np.interp(x, [0, 10, 14, 40, 60, 100], [0, 2, 0, 0, 12, 14])
    ridges = Ground(
        np.tile(profile, (101, 1)).astype(np.float32), (0.0, -50.0), 1.0, WHITE, stain=0.0
    )
    world = bright_world([], ridges)
    light = np.tile((x > 10).astype(np.float32), (101, 1))  # the near hill is black
    world = world._replace(height_field=world.height_field._replace(light=light))
    roll = 0.06
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    pose = make_transform(ALONG_X @ turn, np.array([0.5, 0.0, 3.5]))
    image = render(world, RAYS, static_shutter(pose), pool).image[32:]
    # The crest is the line z = 2 at x = 10.
    ends = np.array([[10.0, -8.0, 2.0], [10.0, 8.0, 2.0]]) - pose[:3, 3]
    u, v = (CAMERA.fx * (ends @ pose[:3, :3])[:, :2] / (ends @ pose[:3, :3])[:, 2:]).T
    columns = np.arange(CAMERA.width) - CAMERA.cx
    crest = CAMERA.cy + np.interp(columns, u[::-1], v[::-1])
    measured = image.sum(axis=0) + 32 - 0.5
    assert np.abs(measured - crest).max() < 0.2
    assert abs(float(np.mean(measured - crest))) < 0.03


def test_clearance_counts_the_height_above_ground() -> None:
    world = bright_world([], HILLS)
    points = np.array([[0.0, 0.0, 0.0], [3.0, 5.0, 0.0]])
    points[:, 2] = heights_at(world.height_field, points) + (3.0, -1.0)
    np.testing.assert_allclose(clearance(world, points), [3.0, 0.0], atol=1e-6)


def test_heights_are_bilinear_and_constant_outside_the_grid() -> None:
    ground = Ground(np.array([[0, 2], [4, 10]], np.float32), (1.0, 2.0), 2.0, WHITE)
    height_field = bright_world([], ground).height_field
    points = np.array([[1.0, 2.0], [2.0, 2.0], [2.0, 3.0], [3.0, 4.0], [9.0, 9.0]])
    np.testing.assert_allclose(heights_at(height_field, points), [0.0, 1.0, 4.0, 10.0, 10.0])
