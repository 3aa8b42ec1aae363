"""World: open country for drones: hills, fields, a road, farms, trees and rocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from data_synth.scene.builder import Builder, Place, Point
from data_synth.scene.height_field import heights_at, make_height_field
from data_synth.scene.lighting import bake_lighting, light_of_session
from data_synth.scene.scene import Body, Course, Heights, Scene
from data_synth.scene.solids import Ground, Kind, Lighting, Solid
from data_synth.worlds import outdoor_textures, vehicles
from data_synth.worlds import terrain_land as land
from data_synth.worlds.bodies import person
from data_synth.worlds.facades import paint_facade, plan_facade, wall_grain
from data_synth.worlds.houses import house
from data_synth.worlds.palette import Palette, paint_palette
from data_synth.worlds.terrain_land import Line, paint_land, roll_hills
from data_synth.worlds.trees import bush, tree
from data_synth.worlds.vehicles import Paint
from vo.base.types import Bools, Floats

_SEED = 40  # of this world, in addition to the seed of the recording
_USUAL_CARS, _USUAL_PEOPLE = 4, 4
_CAR_M_S = 8.0
_HALF_WIDTH_M, _HEAD_ROOM_M = 10.0, 60.0
_NEAREST_M, _FARTHEST_M = 66.0, 96.0  # of the course from the middle
_LOW_M = 0.25  # largest height of objects in the free strip of the course

_Maker = Callable[[Point], None]


def make_scene(seed: int, movers: float, session: int = 0) -> Scene:
    """Ground of 400 x 400 m; the course goes round the middle, 66 m to 96 m from it."""
    build = Builder(np.random.default_rng([seed, _SEED]))
    palette = paint_palette(build)
    colours = vehicles.paints(build, 4)
    course_route = _ring(build, 10, _NEAREST_M, _FARTHEST_M)
    road = _smooth(_ring(build, 7, 36.0, 44.0), 240)
    walk = _smooth(_ring(build, 9, 53.0, 57.0), 280)
    lines = (
        Line(walk, 1.8, paved=False, closed=True),
        *(Line(_track(build, road), 2.6, paved=False, closed=False) for _ in range(4)),
        Line(road, land.ROAD_M, paved=True, closed=True),
    )
    sites = _sites(build)
    ground = _ground(build, lines, sites)
    heights = partial(heights_at, make_height_field(ground))
    _farms(build, palette, heights, sites)
    routes = [line.route for line in lines]
    _plants_and_rocks(build, palette, heights, _Free(course_route, routes, sites))
    _horizon(build, palette, ground)
    bodies = (
        *_cars(build, palette, colours, road, movers),
        *_people(build, walk, round(_USUAL_CARS * movers), movers),
    )
    course = Course(course_route, _HALF_WIDTH_M, _HEAD_ROOM_M, heights, 40.0)
    light = light_of_session(_daylight(build), seed, session)
    return Scene(bake_lighting(build.world(), light), course, bodies)


def _daylight(build: Builder) -> Lighting:
    turn = float(build.rng.uniform(0, 2 * np.pi))
    sun = (float(np.cos(turn)), float(np.sin(turn)), float(build.rng.uniform(1.0, 1.7)))
    return Lighting(
        sun=sun,
        sun_power=0.95,
        ambient=0.5,
        sky=0.9,
        corner_m=2.5,
        points_per_m=1.6,
        max_points=48,
    )


def _ring(build: Builder, corners: int, low_m: float, high_m: float) -> Floats:
    """Corners (K, 2) about the middle, counter-clockwise."""
    turns = 2 * np.pi * (np.arange(corners) + build.rng.uniform(-0.15, 0.15, corners)) / corners
    reach = build.rng.uniform(low_m, high_m, corners)
    return np.asarray(np.column_stack([np.cos(turns), np.sin(turns)]) * reach[:, None])


def _smooth(corners: Floats, count: int) -> Floats:
    """A round curve (count, 2) near the corners, its points about equally far apart."""
    finer = np.repeat(corners, 24, axis=0)
    window = np.hanning(61) / np.hanning(61).sum()
    wrapped = np.vstack([finer[-30:], finer, finer[:30]])
    curve = np.column_stack([np.convolve(c, window, mode="valid") for c in wrapped.T])
    closed = np.vstack([curve, curve[:1]])
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(count) * along[-1] / count
    return np.column_stack([np.interp(at, along, c) for c in closed.T])


def _track(build: Builder, road: Floats) -> Floats:
    """A cart track from the road outwards, winding."""
    start = road[int(build.rng.integers(len(road)))]
    heading = float(np.arctan2(start[1], start[0]))
    turns = heading + np.cumsum(build.rng.normal(0, 0.16, 26))
    steps = 3.2 * np.column_stack([np.cos(turns), np.sin(turns)])
    return np.asarray(start + np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]))


def _sites(build: Builder) -> Floats:
    """Sites of houses (N, 2): in the middle, and outside the course."""
    turns = build.rng.uniform(0, 2 * np.pi / 3) + 2 * np.pi * np.arange(3) / 3
    inner = 17.0 * np.column_stack([np.cos(turns), np.sin(turns)])
    turns = build.rng.uniform(0, 2 * np.pi / 7) + 2 * np.pi * np.arange(7) / 7
    reach = build.rng.uniform(120.0, 135.0, 7)
    outer = reach[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
    return np.vstack([inner, outer])


def _ground(build: Builder, lines: tuple[Line, ...], sites: Floats) -> Ground:
    heights = roll_hills(build.rng, lines, sites)
    texture = build.paint(lambda rng, shape: paint_land(rng, lines))
    corner = (-land.SIDE_M / 2, -land.SIDE_M / 2)
    build.ground = Ground(heights, corner, land.CELL_M, texture, land.TEXELS_PER_M, 0.35)
    return build.ground


def _farms(build: Builder, palette: Palette, heights: Heights, sites: Floats) -> None:
    """A house and sheds at each site, turned at random."""
    grain = wall_grain(build.rng)
    for site in sites:
        z = float(heights(site[None])[0])
        place = Place(float(site[0]), float(site[1]), float(build.rng.uniform(0, 2 * np.pi)))
        plan = plan_facade(build.rng, float(build.rng.uniform(9, 13)), 2)
        front, first = paint_facade(build, plan, grain), len(build.solids)
        back = Place(*place.at(0, -4.0, 0)[:2], place.yaw)
        house(build, palette, back, plan, front, 8.0, roof_steps=12)
        for x, wide in ((-9.0, 4.0), (9.5, 5.0)):
            at = place.at(x, 1.0, 1.4)
            build.add(at, (wide, 6.0, 2.8), palette.bark, place.yaw, 60.0, stain=0.4)
            at = place.at(x, 1.0, 2.9)
            build.add(at, (wide + 0.6, 6.6, 0.25), palette.tiles, place.yaw, 50.0, stain=0.4)
        footing = (24.0, 12.0, 1.2)
        build.add(place.at(0, 0.5, -0.57), footing, palette.cobbles, place.yaw, 40.0, stain=0.5)
        _lift(build, first, z)


def _lift(build: Builder, first: int, height: float) -> None:
    """Raise all solids from number `first` on."""
    for k in range(first, len(build.solids)):
        x, y, z = build.solids[k].centre
        build.solids[k] = replace(build.solids[k], centre=(x, y, z + height))


class _Free:
    """Test for free places of plants and rocks."""

    def __init__(self, course: Floats, routes: list[Floats], sites: Floats) -> None:
        self._course, self._routes, self._sites = _dense(course), np.vstack(routes), sites

    def __call__(self, points: Floats, radius: Floats, low: bool) -> Bools:
        """Whether objects of these radii fit at points (N, 2); low ones may be on the course."""
        free = _distance(points, self._routes) > radius + 3.4
        free &= _distance(points, self._sites) > radius + 17.0
        if not low:
            # A course may cut its corners, or weave, within its half width.
            free &= _distance(points, self._course) > radius + _HALF_WIDTH_M + 2.0
        return np.asarray(free)


def _dense(route: Floats) -> Floats:
    fractions = np.linspace(0, 1, 40, endpoint=False)[:, None]
    ends = np.roll(route, -1, axis=0)
    return np.vstack([a + fractions * (b - a) for a, b in zip(route, ends, strict=True)])


def _distance(points: Floats, others: Floats) -> Floats:
    return np.asarray(np.linalg.norm(points[:, None] - others, axis=2).min(axis=1))


def _plants_and_rocks(build: Builder, palette: Palette, heights: Heights, free: _Free) -> None:
    rng = build.rng

    def wood(foot: Point) -> None:
        high = float(rng.uniform(5, 12))
        tree(build, palette, foot, high, 0.7 * high, clumps=20, bare=0.06)

    def shrub(foot: Point) -> None:
        size = float(rng.uniform(0.8, 2.4))
        bush(build, palette, foot, size, 0.8 * size)

    def rock(foot: Point) -> None:
        _rock(build, palette, foot, float(rng.uniform(0.4, 1.8)))

    def stone(foot: Point) -> None:
        _rock(build, palette, foot, float(rng.uniform(0.15, 0.4)))

    def bale(foot: Point) -> None:
        size, texture = (1.4, 1.4, 1.3), palette.bark
        at = (foot[0], foot[1], foot[2] + 0.6)
        build.add(at, size, texture, 0.0, 60.0, Kind.CYLINDER, 0.5)

    for maker, count, spread, clump, radius, low in (
        (wood, 150, 165.0, 14.0, 4.0, False),
        (shrub, 200, 150.0, 9.0, 1.4, False),
        (rock, 90, 140.0, 10.0, 1.2, False),
        (stone, 260, 120.0, 6.0, 0.3, True),
        (bale, 26, 120.0, 11.0, 0.8, False),
    ):
        points = _clumped(build, count, spread, clump)
        points = points[free(points, np.full(len(points), radius), low)]
        _place(maker, points, heights)


def _place(maker: _Maker, points: Floats, heights: Heights) -> None:
    for (x, y), z in zip(points, heights(points), strict=True):
        maker((float(x), float(y), float(z)))


def _clumped(build: Builder, count: int, spread: float, clump: float) -> Floats:
    """Points (count, 2) in groups, and some alone."""
    groups = build.rng.uniform(-spread, spread, (max(1, count // 7), 2))
    chosen = groups[build.rng.integers(len(groups), size=count)]
    near = chosen + build.rng.normal(0, clump, (count, 2))
    alone = build.rng.uniform(-spread, spread, (count, 2))
    points = np.where(build.rng.random((count, 1)) < 0.75, near, alone)
    return np.asarray(np.clip(points, 3 - land.SIDE_M / 2, land.SIDE_M / 2 - 3))


def _rock(build: Builder, palette: Palette, foot: Point, size: float) -> None:
    wide, deep, high = (float(s) for s in size * build.rng.uniform((1, 0.7, 0.5), (1.5, 1.1, 0.8)))
    high = min(high, 2 * _LOW_M) if size < 0.45 else high  # sunk by half
    yaw = float(build.rng.uniform(0, np.pi))
    build.add(foot, (wide, deep, high), palette.concrete, yaw, 110.0, Kind.ELLIPSOID, 0.5)


def _horizon(build: Builder, palette: Palette, ground: Ground) -> None:
    """Fields beyond the hills, with woods and hills at the horizon."""
    _plain(build, ground)
    for k in range(70):
        turn, reach = 2 * np.pi * k / 70, float(build.rng.uniform(205, 300))
        x, y = reach * np.cos(turn), reach * np.sin(turn)
        high = float(build.rng.uniform(9, 16))
        foot = (float(x), float(y), land.RIM_M)
        tree(build, palette, foot, high, 0.8 * high, clumps=8, bare=0.15)
    wooded = build.paint(outdoor_textures.forest, (1024, 1024))
    for k in range(16):
        turn, reach = 2 * np.pi * (k + build.rng.uniform(0, 0.8)) / 16, build.rng.uniform(400, 750)
        wide, deep, high = (float(s) for s in build.rng.uniform((160, 90, 30), (420, 200, 130)))
        at = (float(reach * np.cos(turn)), float(reach * np.sin(turn)), land.RIM_M - 2.0)
        build.add(at, (deep, wide, high), wooded, float(turn), 2.5, Kind.ELLIPSOID, 0.6)


def _plain(build: Builder, ground: Ground) -> None:
    """Flat ground around the hills, with the same texture and without a seam."""
    # Slightly above the border, whose coarse grid of light would otherwise be visible.
    inner, outer, half = land.SIDE_M / 2 - 0.5, 1200.0, land.TEXTURE_SIDE / 2
    middle, wide = (inner + outer) / 2, outer - inner
    for x, y, size in (
        (0.0, middle, (2 * outer, wide)),
        (0.0, -middle, (2 * outer, wide)),
        (middle, 0.0, (wide, 2 * inner)),
        (-middle, 0.0, (wide, 2 * inner)),
    ):
        u, v = land.TEXELS_PER_M * x + half, -land.TEXELS_PER_M * y + half
        slab = Solid(
            centre=(x, y, land.RIM_M - 0.98),
            size=(*size, 2.0),
            texture=ground.texture,
            density=ground.density,
            offset=(u % land.TEXTURE_SIDE, v % land.TEXTURE_SIDE),
            stain=ground.stain,
        )
        build.solids.append(slab)


def _cars(
    build: Builder, palette: Palette, colours: tuple[Paint, ...], road: Floats, movers: float
) -> list[Body]:
    """Cars on the road, all in the same direction."""
    count, ahead = round(_USUAL_CARS * movers), np.roll(road, -1, axis=0) - road
    right = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    lane = road + 1.35 * right / np.linalg.norm(right, axis=1, keepdims=True)
    bodies = []
    for k in range(count):
        make = vehicles.van if k % 3 == 2 else vehicles.car
        make(build, palette, colours[k % len(colours)], Place(0.0, 0.0, 0.0), body=k)
        start = (k + float(build.rng.uniform(0.0, 0.4))) / count
        bodies.append(Body(f"car {k}", lane[::4], _CAR_M_S, start, vehicles.RADIUS_M))
    return bodies


def _people(build: Builder, walk: Floats, first: int, movers: float) -> list[Body]:
    """People on the path around the road, one behind the other."""
    count = round(_USUAL_PEOPLE * movers)
    bodies = []
    for k in range(count):
        radius = person(build, first + k)
        start = (k + float(build.rng.uniform(0.0, 0.4))) / count
        bodies.append(Body(f"person {k}", walk[::4], 1.3, start, radius))
    return bodies
