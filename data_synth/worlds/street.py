"""World: a town with a rectangle of streets, houses, parked cars, trees, and hills behind."""

from __future__ import annotations

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.scene.lighting import bake_lighting, light_of_session
from data_synth.scene.scene import Body, Course, Scene, flat_ground
from data_synth.scene.solids import Kind, Lighting
from data_synth.worlds import outdoor_textures, vehicles
from data_synth.worlds import street_plan as layout
from data_synth.worlds.bodies import person
from data_synth.worlds.palette import Palette, paint_palette
from data_synth.worlds.street_ground import lay_ground, lay_pavement
from data_synth.worlds.street_sides import Fronts, no_fronts, row_of_houses, verge
from data_synth.worlds.trees import tree
from data_synth.worlds.vehicles import Paint
from vo.base.types import Floats

_SEED = 30  # of this world, in addition to the seed of the recording
_USUAL_CARS, _USUAL_PEOPLE = 5, 8
_TURN_RADIUS_M = 13.0
_ONCOMING_M_S, _ONCOMING_RADIUS_M = 7.0, 7.0


def make_scene(seed: int, movers: float, session: int = 0) -> Scene:
    """A town whose streets make a loop of 150 x 90 m; the course keeps to its right lane.

    The course goes counter-clockwise. Cars come along the other lane, people walk on the pavements.
    """
    build = Builder(np.random.default_rng([seed, _SEED]))
    palette = paint_palette(build)
    colours = vehicles.paints(build, 8)
    fronts = no_fronts(build)
    lay_ground(build, palette)
    for number, side in enumerate(layout.frontages()):
        lay_pavement(build, palette, side, number)
        row_of_houses(build, palette, fronts, side)
        verge(build, palette, colours, side)
    _ends_of_streets(build, palette, fronts)
    _skyline(build, palette, fronts)
    bodies = (*_cars(build, palette, colours, movers), *_people(build, movers))
    light = light_of_session(_daylight(build), seed, session)
    world = bake_lighting(build.world(), light)
    lane = layout.lane(layout.LANE_M, _TURN_RADIUS_M)
    course = Course(lane, 1.5, 2.4, flat_ground(), 30.0, back_left_m=2.0 * layout.LANE_M)
    return Scene(world, course, bodies)


def _daylight(build: Builder) -> Lighting:
    """The sun is not aligned with a street, so that each has a sunny and a shady side."""
    turn = float(build.rng.uniform(0.3, 0.7) + np.pi / 2 * build.rng.integers(4))
    sun = (float(np.cos(turn)), float(np.sin(turn)), float(build.rng.uniform(0.95, 1.4)))
    return Lighting(
        sun=sun,
        sun_power=0.85,
        ambient=0.5,
        sky=0.97,
        corner_m=4.0,
        points_per_m=2.4,
        max_points=50,
    )


def _ends_of_streets(build: Builder, palette: Palette, fronts: Fronts) -> None:
    """A row of houses across the end of each street, which closes the view."""
    for x, y in layout.crossings():
        far_x = x + np.sign(x) * (layout.ARM_M + 8.5)
        far_y = y + np.sign(y) * (layout.ARM_M + 8.5)
        for place in (
            Place(float(far_x), y, float(-np.pi / 2 * np.sign(x))),
            Place(x, float(far_y), 0.0 if y > 0 else np.pi),
        ):
            row_of_houses(build, palette, fronts, layout.Frontage(place, 44.0, on_loop=False))


def _skyline(build: Builder, palette: Palette, fronts: Fronts) -> None:
    """Taller houses and trees behind, and wooded hills at the horizon."""
    for k in range(34):
        turn = 2 * np.pi * (k + float(build.rng.uniform(0, 0.8))) / 34
        reach = float(build.rng.uniform(1.0, 1.35))
        x, y = 175.0 * reach * np.cos(turn), 145.0 * reach * np.sin(turn)
        if k % 3 == 2:
            foot = (float(x), float(y), 0.0)
            tree(build, palette, foot, float(build.rng.uniform(12, 20)), 11.0, clumps=12, bare=0.15)
            continue
        front = fronts.painted[int(build.rng.integers(len(fronts.painted)))][1]
        wide, deep, high = (float(s) for s in build.rng.uniform((16, 12, 14), (28, 20, 34)))
        yaw = float(build.rng.uniform(-0.3, 0.3))
        build.add((float(x), float(y), high / 2), (wide, deep, high), front, yaw, None)
    wooded = build.paint(outdoor_textures.forest, (1024, 1024))
    for k in range(9):
        turn = 2 * np.pi * (k + float(build.rng.uniform(0, 0.7))) / 9
        reach = float(build.rng.uniform(420, 560))
        wide, deep, high = (float(s) for s in build.rng.uniform((320, 170, 70), (520, 260, 150)))
        at = (float(reach * np.cos(turn)), float(reach * np.sin(turn)), -5.0)
        build.add(at, (deep, wide, high), wooded, turn, 2.5, Kind.ELLIPSOID, 0.6)


def _cars(
    build: Builder, palette: Palette, colours: tuple[Paint, ...], movers: float
) -> list[Body]:
    """Cars in the other lane, one behind the other, in the opposite direction."""
    route = layout.lane(-layout.LANE_M, _ONCOMING_RADIUS_M)[::-1].copy()
    count = round(_USUAL_CARS * movers)
    bodies = []
    for k in range(count):
        make = vehicles.van if k % 4 == 3 else vehicles.car
        make(build, palette, colours[k % len(colours)], Place(0.0, 0.0, 0.0), body=k)
        start = (k + float(build.rng.uniform(0.0, 0.4))) / count
        bodies.append(Body(f"car {k}", route, _ONCOMING_M_S, start, vehicles.RADIUS_M))
    return bodies


def _people(build: Builder, movers: float) -> list[Body]:
    """People walking up and down the pavements of the loop."""
    first = round(_USUAL_CARS * movers)
    sides = [side for side in layout.frontages() if side.on_loop]
    bodies = []
    for k in range(round(_USUAL_PEOPLE * movers)):
        side = sides[k % len(sides)]
        radius = person(build, first + k)
        speed, start = (float(c) for c in build.rng.uniform((1.0, 0.0), (1.6, 1.0)))
        bodies.append(Body(f"person {k}", _promenade(side), speed, start, radius))
    return bodies


def _promenade(side: layout.Frontage) -> Floats:
    """There and back along a pavement, between the lamps and the fronts."""
    reach = side.length / 2 - 3.0
    corners = ((-reach, -2.5), (reach, -2.5), (reach, -1.5), (-reach, -1.5))
    return np.array([side.place.at(x, y, 0.0)[:2] for x, y in corners])
