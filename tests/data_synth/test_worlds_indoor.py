from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib import import_module

import cv2
import numpy as np
import pytest

from data_synth.motion.body_path import poses_at
from data_synth.scene.render import Rendered, camera_rays, render
from data_synth.scene.scene import Body, Scene
from data_synth.scene.shutter import static_shutter
from data_synth.scene.world import World, clearance
from data_synth.worlds.registry import make_scene
from vo.base.geometry.transforms import make_transform
from vo.base.types import Bytes, Camera, Floats

INDOORS = {"room": 2, "corridor": 5, "warehouse": 8}  # usual number of movers
SEED = 1
CAMERA = Camera(752, 480, 460.0, 460.0, 375.5, 239.5)


@cache
def _lit(name: str) -> Scene:
    return make_scene(name, SEED, movers=2.0)


@cache
def _dark(name: str, seed: int, movers: float) -> Scene:
    """A world without the light, which takes most of the time to make."""
    module = import_module(f"data_synth.worlds.{name}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "bake_lighting", lambda world, lighting: world)
        scene = module.make_scene(seed, movers)
    assert isinstance(scene, Scene)
    return scene


@pytest.fixture(params=INDOORS)
def scene(request: pytest.FixtureRequest) -> Scene:
    return _lit(request.param)


def _along(route: Floats, step_m: float) -> tuple[Floats, Floats]:
    """Points (N, 2) every `step_m` of a closed route, and the direction (N,) there."""
    places, headings = [], []
    for start, stop in zip(route, np.roll(route, -1, axis=0), strict=True):
        ahead = stop - start
        fraction = np.arange(0.0, 1.0, step_m / np.linalg.norm(ahead))[:, None]
        places.append(start + fraction * ahead)
        headings.append(np.full(len(fraction), np.arctan2(ahead[1], ahead[0])))
    return np.vstack(places), np.concatenate(headings)


def _at_heights(places: Floats, heights_m: tuple[float, ...]) -> Floats:
    return np.vstack([np.column_stack([places, np.full(len(places), z)]) for z in heights_m])


def _pose(place: Floats, height_m: float, heading: float) -> Floats:
    """world_from_cam of a horizontal camera along a heading."""
    cosine, sine = np.cos(heading), np.sin(heading)
    rotation = np.array([[sine, 0.0, cosine], [-cosine, 0.0, sine], [0.0, -1.0, 0.0]])
    return make_transform(rotation, np.array([*place, height_m]))


def _views(
    scene: Scene, pool: ThreadPoolExecutor, count: int, turn: float = 0.0
) -> Iterator[tuple[Rendered, Floats]]:
    """Views and their poses at points evenly spaced along the course, `turn` left of ahead."""
    places, headings = _along(scene.course.waypoints, 0.2)
    rays = camera_rays(CAMERA)
    for i in np.linspace(0, len(places), count, endpoint=False).astype(int):
        pose = _pose(places[i], 0.6 + 0.3 * (i % 4), headings[i] + turn)
        yield render(scene.world, rays, static_shutter(pose), pool), pose


def _image(view: Rendered) -> Bytes:
    return np.asarray(np.clip(view.image * 255.0, 0.0, 255.0), dtype=np.uint8)


def _corners(view: Rendered, threshold: int) -> int:
    return len(cv2.FastFeatureDetector.create(threshold).detect(_image(view)))


def _same(first: World, second: World) -> bool:
    return (
        np.array_equal(first.shapes, second.shapes)
        and np.array_equal(first.atlas.texels, second.atlas.texels)
        and np.array_equal(first.offsets, second.offsets)
        and np.array_equal(first.textures, second.textures)
    )


@pytest.mark.parametrize("name", INDOORS)
def test_world_depends_on_the_seed_only(name: str) -> None:
    first, again = _lit(name), _dark(name, SEED, 2.0)
    assert _same(first.world, again.world)
    assert np.array_equal(first.course.waypoints, again.course.waypoints)
    assert not _same(first.world, _dark(name, SEED + 1, 2.0).world)


@pytest.mark.parametrize("name", INDOORS)
@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_course_is_free_on_its_whole_width(name: str, seed: int) -> None:
    scene = _dark(name, seed, 2.0)
    turn = np.arange(8) * np.pi / 4
    rim = scene.course.half_width_m * np.column_stack([np.cos(turn), np.sin(turn)])
    places = _along(scene.course.waypoints, 0.6)[0]
    around = np.vstack([places + offset for offset in rim] + [places])
    assert clearance(scene.world, _at_heights(around, (0.3, 1.0, 1.8))).min() > 0.25
    overhead = _at_heights(places, (scene.course.head_room_m,))
    assert clearance(scene.world, overhead).min() > 0.0


def test_corners_are_as_many_as_in_real_images(scene: Scene, pool: ThreadPoolExecutor) -> None:
    counts = [_corners(view, 20) for view, _ in _views(scene, pool, 9)]
    assert max(counts) < 4500
    assert np.median(counts) > 350
    assert min(counts) > 80


def test_corridor_has_views_with_few_and_with_many_corners(pool: ThreadPoolExecutor) -> None:
    views = _views(_lit("corridor"), pool, 28, turn=-np.pi / 2)
    counts = [_corners(view, 7) for view, _ in views]
    bare = sorted(counts)[2]
    assert 10 < bare < 150
    assert max(counts) > 10 * bare


def test_white_walls_have_no_corners_and_the_floor_has(pool: ThreadPoolExecutor) -> None:
    white = make_scene("white_corridor", SEED)
    aside = [_corners(view, 7) for view, _ in _views(white, pool, 28, turn=np.pi / 2)]
    assert np.median(aside) < 5
    assert min(_corners(view, 7) for view, _ in _views(white, pool, 5)) > 50


def test_brightness_uses_the_range_without_clipping(scene: Scene, pool: ThreadPoolExecutor) -> None:
    for view, _ in _views(scene, pool, 7, turn=0.6):
        assert 0.25 < view.image.mean() < 0.7
        assert (view.image > 0.99).mean() < 0.12
        assert view.image.std() > 0.04


def test_depth_is_not_a_single_plane(scene: Scene, pool: ThreadPoolExecutor) -> None:
    """Nearly all planes are level or upright along x or y: few pixels share one coordinate."""
    rays = camera_rays(CAMERA)
    ratios = []
    for view, pose in _views(scene, pool, 7, turn=0.3):
        points = (rays * view.depth[..., None]).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
        for axis in range(3):
            bins = np.floor((points[:, axis] + 100.0) / 0.05).astype(np.int64)
            assert np.bincount(bins).max() < 0.7 * len(points)
        near, far = np.percentile(view.depth, (5, 95))
        ratios.append(far / near)
    assert np.median(ratios) > 1.8


@pytest.mark.parametrize("name", INDOORS)
def test_number_of_movers_follows_the_setting(name: str) -> None:
    scene = _lit(name)
    names = [body.name for body in scene.bodies]
    assert len(set(names)) == len(names) == 2 * INDOORS[name]
    assert np.array_equal(np.unique(scene.world.movers.bodies), np.arange(len(names)))


def test_there_are_no_movers_by_default() -> None:
    scene = _dark("corridor", SEED, 0.0)
    assert scene.bodies == ()
    assert len(scene.world.bounds) == len(scene.world.kinds)


@pytest.mark.parametrize("name", INDOORS)
def test_bodies_are_on_the_ground_and_within_their_radius(name: str) -> None:
    scene = _lit(name)
    world = scene.world
    halves = world.shapes[len(world.bounds) :, 3:6]
    for i, body in enumerate(scene.bodies):
        mine = world.movers.bodies == i
        places, half = world.movers.places[mine], halves[mine]
        assert -0.01 < (places[:, 2] - half[:, 2]).min() < 0.03
        assert _reach(places, half) <= body.radius_m
        assert _reach(places, half) > 0.6 * body.radius_m


def _reach(places: Floats, halves: Floats) -> float:
    """Distances of the corners of solids from the axis of their body."""
    cosine, sine = np.cos(places[:, 3]), np.sin(places[:, 3])
    far = 0.0
    for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        across, along = x * halves[:, 0], y * halves[:, 1]
        corner_x = places[:, 0] + cosine * across - sine * along
        corner_y = places[:, 1] + sine * across + cosine * along
        far = max(far, float(np.hypot(corner_x, corner_y).max()))
    return far


@pytest.mark.parametrize("name", INDOORS)
def test_bodies_keep_clear_of_solids(name: str) -> None:
    scene = _lit(name)
    routes: dict[bytes, Body] = {body.route.tobytes(): body for body in scene.bodies}
    for body in routes.values():
        lap_s = np.arange(0.0, 250.0 if name != "room" else 20.0, 0.5)
        poses, _ = poses_at(body, lap_s, scene.course.ground)
        middles = _at_heights(poses[:, :2, 3], (0.4, 1.2))
        assert clearance(scene.world, middles).min() > 0.2
