"""Moving bodies: people, carts and forklifts.

Each function adds the solids of one body in the frame of the body: origin on the ground below its
middle, x ahead and z up. It returns the radius of an upright cylinder that contains the body.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from data_synth.scene.builder import Builder, Point
from data_synth.scene.solids import Kind
from data_synth.worlds import indoor_textures, prints, textures
from vo.base.types import Floats


@dataclass
class _Body:
    """Adds solids to one body, with an offset `at`."""

    build: Builder
    number: int
    at: Point = (0.0, 0.0, 0.0)

    def add(
        self,
        kind: Kind,
        centre: Point,
        size: Point,
        texture: int,
        density: float | None = 260.0,
        yaw: float = 0.0,
    ) -> None:
        x, y, z = (a + c for a, c in zip(self.at, centre, strict=True))
        self.build.add((x, y, z), size, texture, yaw, density, kind, body=self.number)


def person(build: Builder, body: int, at: Point = (0.0, 0.0, 0.0)) -> float:
    """A person in mid-step, 1.55 m to 1.9 m tall, sometimes with a bag."""
    height = float(build.rng.uniform(1.55, 1.9))
    shirt, trousers = (build.paint(indoor_textures.cloth, (256, 256)) for _ in range(2))
    shoes = build.paint(partial(indoor_textures.steel, shade=0.15), (64, 64))
    figure, unit = _Body(build, body, at), height / 1.75
    _head_and_trunk(figure, shirt, unit)
    for side in (-1.0, 1.0):
        step = 0.11 * side
        for x, z, size in (
            (0.4 * step, 0.67, (0.19, 0.17, 0.46)),
            (step, 0.3, (0.14, 0.13, 0.5)),
        ):
            centre = (unit * x, unit * 0.1 * side, unit * z)
            scaled = (unit * size[0], unit * size[1], unit * size[2])
            figure.add(Kind.ELLIPSOID, centre, scaled, trousers)
        sole = (unit * (step + 0.05), unit * 0.1 * side, unit * 0.05)
        figure.add(Kind.ELLIPSOID, sole, (0.28 * unit, 0.1 * unit, 0.1 * unit), shoes)
    if build.rng.random() < 0.5:
        bag = build.paint(textures.fabric, (128, 128))
        side = float(build.rng.choice((-1.0, 1.0)))
        size = (0.34 * unit, 0.1 * unit, 0.26 * unit)
        figure.add(Kind.BOX, (-0.02, 0.3 * side * unit, 0.68 * unit), size, bag)
    return 0.45


def _head_and_trunk(figure: _Body, shirt: int, unit: float) -> None:
    head = figure.build.paint(indoor_textures.skin, (128, 128))
    hair = figure.build.paint(indoor_textures.hair, (64, 128))
    for centre, size, texture, density in (
        ((0.02, 0.0, 1.63), (0.2, 0.17, 0.25), head, None),
        ((0.0, 0.0, 1.66), (0.21, 0.18, 0.22), hair, 400.0),
        ((0.0, 0.0, 1.47), (0.13, 0.13, 0.2), head, None),
        ((0.0, 0.0, 1.2), (0.28, 0.44, 0.62), shirt, 260.0),
        ((0.0, 0.0, 0.93), (0.26, 0.36, 0.34), shirt, 260.0),
        ((0.06, 0.235, 1.1), (0.13, 0.12, 0.62), shirt, 260.0),
        ((-0.06, -0.235, 1.1), (0.13, 0.12, 0.62), shirt, 260.0),
        ((0.1, 0.26, 0.78), (0.1, 0.08, 0.16), head, None),
        ((-0.1, -0.26, 0.78), (0.1, 0.08, 0.16), head, None),
    ):
        scaled = (unit * size[0], unit * size[1], unit * size[2])
        middle = (unit * centre[0], unit * centre[1], unit * centre[2])
        figure.add(Kind.ELLIPSOID, middle, scaled, texture, density)


def cart(build: Builder, body: int) -> float:
    """A person pushing a trolley with cartons."""
    person(build, body, at=(-0.55, 0.0, 0.0))
    frame = build.paint(indoor_textures.steel, (128, 128))
    cartons = [build.paint(textures.carton, (256, 256)) for _ in range(2)]
    trolley = _Body(build, body, at=(0.35, 0.0, 0.0))
    for z in (0.16, 0.62):
        trolley.add(Kind.BOX, (0.0, 0.0, z), (0.9, 0.56, 0.04), frame)
    for x in (-0.43, 0.43):
        for y in (-0.26, 0.26):
            top = 1.0 if x < 0.0 else 0.64
            trolley.add(Kind.BOX, (x, y, 0.5 * (top + 0.12)), (0.04, 0.04, top - 0.12), frame)
            trolley.add(Kind.ELLIPSOID, (x, y, 0.06), (0.12, 0.05, 0.12), frame)
    trolley.add(Kind.BOX, (-0.43, 0.0, 1.0), (0.04, 0.56, 0.04), frame)
    for z, texture in ((0.18, cartons[0]), (0.64, cartons[1])):
        for x in (-0.2, 0.21):
            size = tuple(float(s) for s in build.rng.uniform((0.3, 0.36, 0.2), (0.38, 0.5, 0.36)))
            turn = float(build.rng.uniform(-0.1, 0.1))
            centre = (x, 0.0, z + size[2] / 2)
            trolley.add(Kind.BOX, centre, (size[0], size[1], size[2]), texture, yaw=turn)
    return 0.95


def forklift(build: Builder, body: int) -> float:
    """A counterbalanced forklift with its driver and a loaded pallet."""
    paint = build.paint(indoor_textures.steel, (256, 256))
    dark = build.paint(partial(indoor_textures.steel, shade=0.18), (128, 128))
    stripes = build.paint(prints.hazard, (64, 128))
    truck = _Body(build, body, at=(-0.35, 0.0, 0.0))
    truck.add(Kind.BOX, (-0.1, 0.0, 0.42), (1.7, 1.0, 0.5), paint)
    truck.add(Kind.BOX, (-0.7, 0.0, 0.82), (0.55, 1.0, 0.36), paint)
    truck.add(Kind.BOX, (-0.985, 0.0, 0.7), (0.02, 0.9, 0.22), stripes, None)
    truck.add(Kind.BOX, (0.0, 0.0, 2.08), (1.3, 1.0, 0.05), dark)
    for x, y in ((-0.6, 0.46), (-0.6, -0.46), (0.55, 0.46), (0.55, -0.46)):
        truck.add(Kind.BOX, (x, y, 1.4), (0.06, 0.06, 1.4), dark)
    for x, across in ((-0.62, 0.46), (0.5, 0.6)):
        for y in (-0.44, 0.44):
            truck.add(Kind.ELLIPSOID, (x, y, 0.5 * across), (across, 0.22, across), dark)
    for y in (-0.3, 0.3):
        truck.add(Kind.BOX, (0.83, y, 1.15), (0.12, 0.1, 2.1), dark)
        truck.add(Kind.BOX, (1.3, y, 0.2), (0.9, 0.12, 0.05), dark)
    for z in (0.5, 1.3, 2.15):
        truck.add(Kind.BOX, (0.83, 0.0, z), (0.06, 0.6, 0.08), dark)
    _head_and_trunk(
        _Body(build, body, at=(-0.55, 0.0, -0.1)),
        build.paint(indoor_textures.cloth, (256, 256)),
        1.0,
    )
    wood = build.paint(textures.planks, (128, 128))
    goods = build.paint(prints.carton_stack, (256, 256))
    truck.add(Kind.BOX, (1.35, 0.0, 0.29), (0.85, 1.1, 0.12), wood)
    high = float(np.round(build.rng.uniform(0.5, 0.9), 3))
    truck.add(Kind.BOX, (1.35, 0.0, 0.35 + high / 2), (0.82, 1.06, high), goods, None)
    return 1.55


def beside(route: Floats, left_m: float) -> Floats:
    """A closed route (K, 2) of right-angled turns, moved to the left of its direction."""
    ahead = np.roll(route, -1, axis=0) - route
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    return np.asarray(route + left_m * (left + np.roll(left, 1, axis=0)))
