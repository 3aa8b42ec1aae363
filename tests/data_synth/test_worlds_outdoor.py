from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from data_synth.scene import builder
from data_synth.scene.render import Rendered, camera_rays, render
from data_synth.scene.scene import Scene
from data_synth.scene.shutter import static_shutter
from data_synth.scene.world import World, build_world, clearance
from data_synth.worlds import street, terrain
from vo.base.geometry.transforms import make_transform
from vo.base.types import Bytes, Camera, Floats

CAMERA = Camera(613, 185, 359, 359, 306, 92)
WORLDS = pytest.mark.parametrize("module", [street, terrain], ids=["street", "terrain"])


def _made(module: ModuleType) -> tuple[Scene, list[bytes]]:
    """A world, and all parts it was built of."""
    parts: list[bytes] = []

    def build(*of: Any) -> World:
        parts.extend(_as_bytes(*of))
        return build_world(*of)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(builder, "build_world", build)
        return module.make_scene(0, 1.0), parts


def _as_bytes(
    solids: object, textures: list[Floats], ground: Any, bodies: object
) -> Iterator[bytes]:
    yield repr((solids, bodies)).encode()
    yield from (texture.tobytes() for texture in textures)
    yield b"" if ground is None else ground.heights.tobytes()


@pytest.fixture(scope="module")
def made_town() -> tuple[Scene, list[bytes]]:
    return _made(street)


@pytest.fixture(scope="module")
def made_country() -> tuple[Scene, list[bytes]]:
    return _made(terrain)


@pytest.fixture(scope="module")
def town(made_town: tuple[Scene, list[bytes]]) -> Scene:
    return made_town[0]


@pytest.fixture(scope="module")
def country(made_country: tuple[Scene, list[bytes]]) -> Scene:
    return made_country[0]


@pytest.fixture(scope="module")
def threads() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as pool:
        yield pool


def _along(route: Floats, step_m: float) -> tuple[Floats, Floats]:
    """Points (N, 2) of a closed route and its directions (N, 2) there."""
    legs = np.roll(route, -1, axis=0) - route
    lengths = np.linalg.norm(legs, axis=1)
    points, ahead = [], []
    for start, leg, length in zip(route, legs, lengths, strict=True):
        fractions = np.arange(0.0, length, step_m)[:, None] / length
        points.append(start + fractions * leg)
        ahead.append(np.repeat((leg / length)[None], len(fractions), axis=0))
    return np.vstack(points), np.vstack(ahead)


def _view(
    world: World, at: Floats, ahead: Floats, down_rad: float, pool: ThreadPoolExecutor
) -> tuple[Bytes, Rendered]:
    cosine, sine = np.cos(down_rad), np.sin(down_rad)
    forward = np.array([*(cosine * ahead), -sine])
    right = np.array([ahead[1], -ahead[0], 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    seen = render(world, camera_rays(CAMERA), static_shutter(make_transform(rotation, at)), pool)
    return np.clip(255 * seen.image, 0, 255).astype(np.uint8), seen


def _ingredients(
    module: ModuleType, seed: int, movers: float, monkeypatch: pytest.MonkeyPatch
) -> list[bytes]:
    """All parts of a world, without the cost of building it."""
    caught: list[bytes] = []
    monkeypatch.setattr(builder, "build_world", lambda *of: caught.extend(_as_bytes(*of)))
    monkeypatch.setattr(module, "bake_lighting", lambda world, light: world)
    module.make_scene(seed, movers)
    return caught


@pytest.mark.parametrize(("module", "name"), [(street, "made_town"), (terrain, "made_country")])
def test_world_depends_on_the_seed_only(
    module: ModuleType, name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = request.getfixturevalue(name)[1]
    assert len(first) > 10
    assert first == _ingredients(module, 0, 1.0, monkeypatch)
    monkeypatch.setattr(builder.Builder, "paint", _blank)
    third, fourth = (_ingredients(module, seed, 0.0, monkeypatch)[0] for seed in (3, 4))
    assert third != fourth


def _blank(build: builder.Builder, painter: object, shape: tuple[int, int] = (4, 4)) -> int:
    build.textures.append(np.zeros((4, 4), np.float32))
    return len(build.textures) - 1


@WORLDS
def test_movers_setting_changes_only_the_number_of_movers(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "bake_lighting", lambda world, light: world)
    monkeypatch.setattr(builder, "build_world", lambda solids, *others: len(solids))
    monkeypatch.setattr(builder.Builder, "paint", _blank)
    empty, busy = (module.make_scene(5, movers) for movers in (0.0, 1.5))
    assert len(empty.bodies) == 0
    assert len(busy.bodies) >= 12
    assert empty.world == busy.world
    assert len({body.name for body in busy.bodies}) == len(busy.bodies)


@pytest.mark.parametrize("name, heights_m", [("town", (1.0, 1.65, 2.2)), ("country", (0.8, 8, 25))])
def test_course_is_free_at_its_full_width(
    name: str, heights_m: tuple[float, ...], request: pytest.FixtureRequest
) -> None:
    scene: Scene = request.getfixturevalue(name)
    points, ahead = _along(scene.course.waypoints, 2.5)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]]) * scene.course.half_width_m
    for shift in (-1.0, 0.0, 1.0):
        xy = points + shift * left
        for height in heights_m:
            z = scene.course.ground(xy) + height
            assert clearance(scene.world, np.column_stack([xy, z])).min() > 0.3


def test_course_of_the_street_starts_with_a_straight(town: Scene) -> None:
    sides = np.linalg.norm(np.diff(town.course.waypoints, axis=0), axis=1)
    assert sides[0] > 50.0


@pytest.mark.parametrize("name", ["town", "country"])
def test_routes_of_bodies_keep_clear_of_the_course(
    name: str, request: pytest.FixtureRequest
) -> None:
    scene: Scene = request.getfixturevalue(name)
    lane, _ = _along(scene.course.waypoints, 0.5)
    for body in scene.bodies:
        points, _ = _along(body.route, 1.0)
        apart = np.linalg.norm(points[:, None] - lane, axis=2).min()
        assert apart > 1.5 + 0.9, body.name  # beside a car's half width


def test_street_has_corners_and_depths_like_real_streets(
    town: Scene, threads: ThreadPoolExecutor
) -> None:
    points, ahead = _along(town.course.waypoints, 4.0)
    for k in range(0, len(points), len(points) // 7):
        at = np.array([*points[k], 1.65])
        image, seen = _view(town.world, at, ahead[k], 0.0, threads)
        corners = cv2.FastFeatureDetector_create(20).detect(image)
        assert 300 < len(corners) < 3000  # real ones of this size have 600 to 1300
        depths = seen.depth[np.isfinite(seen.depth)]
        assert np.percentile(depths, 1) < 8.0
        assert depths.max() > 60.0
        assert 0.005 < np.isinf(seen.depth).mean() < 0.35
        assert 45 < image.mean() < 140
        assert image.std() > 35


@pytest.mark.parametrize("height_m, down_deg", [(12.0, 35.0), (28.0, 35.0), (18.0, 89.0)])
def test_country_has_corners_everywhere_from_above(
    country: Scene, threads: ThreadPoolExecutor, height_m: float, down_deg: float
) -> None:
    points, ahead = _along(country.course.waypoints, 4.0)
    for k in range(0, len(points), len(points) // 5):
        z = float(country.course.ground(points[k : k + 1])[0]) + height_m
        at = np.array([*points[k], z])
        image, seen = _view(country.world, at, ahead[k], np.deg2rad(down_deg), threads)
        corners = cv2.FastFeatureDetector_create(20).detect(image)
        assert 200 < len(corners) < 6000
        u, v = np.array([c.pt for c in corners]).T
        counts = np.histogram2d(v, u, bins=(3, 6), range=((0, 185), (0, 613)))[0]
        assert counts.min() >= 3
        assert np.isfinite(seen.depth).mean() > 0.99
        assert 45 < image.mean() < 170


def test_country_is_hilly_with_a_level_rim(country: Scene) -> None:
    axis = np.linspace(-120.0, 120.0, 60)
    grid = np.column_stack([g.ravel() for g in np.meshgrid(axis, axis)])
    heights = country.course.ground(grid)
    assert 8.0 < np.ptp(heights) < 45.0
    rim = np.column_stack([np.full(50, 199.0), np.linspace(-199.0, 199.0, 50)])
    assert np.ptp(country.course.ground(rim)) < 0.1
