"""World: a warehouse with rows of racks, similar aisles, a high roof and loading doors."""

from __future__ import annotations

from functools import partial

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.scene.lighting import bake_lighting, light_of_session
from data_synth.scene.scene import Body, Course, Scene, flat_ground
from data_synth.scene.solids import Lighting
from data_synth.worlds import bodies, hall, prints, racks
from vo.base.types import Floats

HALF_WIDTH_M = 1.0
_BAYS = 4
_BLOCKS_X = (-11.0, 3.0)  # middles of the two blocks of racks
_ROWS_Y = (-8.1, -2.7, 2.7, 8.1)
_AISLES_Y = (-10.8, -5.4, 0.0, 5.4, 10.8)
_CROSSINGS_X = (-18.2, -4.0, 10.2)
_LANE_X = 12.6  # lane of forklifts in front of the loading doors
_BACK_GAP_M = 0.08
_ASIDE_M = {"person": 0.9, "cart": 0.55}  # carts cut corners more
_USUAL = {"person": 4, "cart": 2, "forklift": 2}


def make_scene(seed: int, movers: float = 0.0, session: int = 0) -> Scene:
    """A hall of 40 x 27 x 7.4 m with eight double rows of racks in two blocks.

    The course is a figure of eight of 89 m through three of the five aisles, which crosses itself
    in the middle; the seed determines its mirroring and direction.
    """
    build = Builder(np.random.default_rng([seed, 37]))
    kit = racks.make_kit(build)
    hall.shell(build)
    _racks(build, kit)
    _floor_paint(build)
    _staging(build, kit)
    lamps = hall.lamps(build, _AISLES_Y)
    side = float(build.rng.choice((-1.0, 1.0)))
    route = _route(side)[:: int(build.rng.choice((-1, 1)))]
    course = Course(route, HALF_WIDTH_M, 5.0, flat_ground(), view_yaw_deg=25.0)
    movers_ = _movers(build, route, side, movers)
    light = Lighting(lamps, ambient=0.82, points_per_m=1.5, max_points=160)
    light = light_of_session(light, seed, session)
    return Scene(bake_lighting(build.world(), light), course, movers_)


def _route(side: float) -> Floats:
    first, _, last = _CROSSINGS_X
    y1, y2, _, y4, _ = (side * y for y in _AISLES_Y)
    middle = _CROSSINGS_X[1]
    return np.array([[first, y2], [last, y2], [last, y4], [middle, y4], [middle, y1], [first, y1]])


def _racks(build: Builder, kit: racks.Kit) -> None:
    for block, x in enumerate(_BLOCKS_X):
        for row, y in enumerate(_ROWS_Y):
            racks.rack(build, kit, Place(x, y - _BACK_GAP_M, 0.0), _BAYS)
            racks.rack(build, kit, Place(x, y + _BACK_GAP_M, np.pi), _BAYS)
            for end in (-1.0, 1.0):
                _row_end(build, kit, Place(x, y, 0.0), end, f"{'ABCD'[row]}{2 * block + (end > 0)}")
        for y, yaw in ((hall.DEPTH_M / 2 - 0.02, 0.0), (-hall.DEPTH_M / 2 + 0.02, np.pi)):
            racks.rack(build, kit, Place(x, y, yaw), _BAYS)


def _row_end(build: Builder, kit: racks.Kit, place: Place, end: float, name: str) -> None:
    """The guard at the end of a double row, and the plate with its name."""
    x = end * (_BAYS * racks.BAY_M / 2 + 0.12)
    wide = 2 * racks.DEPTH_M + 2 * _BACK_GAP_M
    build.add(place.at(x, 0.0, 0.22), (0.06, wide, 0.3), kit.hazard)
    plate = build.paint(partial(prints.sign, text=name), (256, 256))
    build.add(place.at(x - 0.06 * end, 0.0, 2.5), (0.02, 0.9, 0.9), plate, density=None)
    small = int(build.rng.choice(kit.labels))
    at = place.at(x - 0.06 * end, float(build.rng.uniform(-0.7, 0.7)), 1.5)
    build.add(at, (0.02, 0.42, 0.3), small, density=None)


def _floor_paint(build: Builder) -> None:
    """Lines along the racks and in front of the doors, and numbers on the floor."""
    paint = build.paint(prints.worn_paint, (256, 256))
    long = _BAYS * racks.BAY_M + 0.6
    for x in _BLOCKS_X:
        for y in _ROWS_Y:
            for side in (-1.0, 1.0):
                build.add((x, y + 1.32 * side, 0.0), (long, 0.1, 0.008), paint, stain=0.5)
    for y in np.arange(-8.0, 8.1, 4.0):
        build.add((16.7, float(y), 0.0), (5.0, 0.12, 0.008), paint, stain=0.5)
    for x in (11.35, 13.85):
        build.add((x, 0.0, 0.0), (0.12, 22.0, 0.008), paint, stain=0.5)
    for i, y in enumerate(_AISLES_Y):
        number = build.paint(partial(prints.sign, text=str(i + 1), dark_ground=True), (128, 128))
        for x in (-16.9, 8.9):
            build.add((x, y, 0.0), (0.8, 0.8, 0.008), number, np.pi / 2, None)


def _staging(build: Builder, kit: racks.Kit) -> None:
    """Goods on the floor in front of the loading doors."""
    rng = build.rng
    for y in np.arange(-10.0, 10.1, 4.0):
        for x in (14.9, 16.0, 17.1):
            for side in (-0.62, 0.62):
                if rng.random() < 0.62:
                    spot = Place(x, float(y) + side, float(rng.normal(0, 0.06)))
                    racks.pallet(build, kit, spot, 0.0)


def _movers(build: Builder, route: Floats, side: float, scale: float) -> tuple[Body, ...]:
    """People next to the middle of the course, forklifts in aisles off the course."""
    found: list[Body] = []
    rng = build.rng
    for name, make, speeds in (
        ("person", bodies.person, (0.9, 1.5)),
        ("cart", bodies.cart, (0.7, 1.2)),
        ("forklift", bodies.forklift, (1.8, 1.8)),
    ):
        count = round(_USUAL[name] * scale)
        for i in range(count):
            radius = make(build, len(found))
            speed, start = float(rng.uniform(*speeds)), float((i + rng.random()) / count)
            path = _forklift_route(side)
            if name != "forklift":
                path = bodies.beside(route[:: int(rng.choice((-1, 1)))], -_ASIDE_M[name])
            found.append(Body(f"{name} {i}", path, speed, start, radius))
    return tuple(found)


def _forklift_route(side: float) -> Floats:
    left, right, low, high = _CROSSINGS_X[0], _LANE_X, _AISLES_Y[2], side * _AISLES_Y[4]
    return np.array([[right, low], [right, high], [left, high], [left, low]])
