"""Town houses: walls, painted fronts, and roofs, ledges, shop fronts and balconies."""

from __future__ import annotations

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.scene.solids import Kind
from data_synth.worlds.facades import Facade
from data_synth.worlds.palette import Palette

_SKIN_M = 0.3
_OUT_M = 0.04  # distance of the painted front from the walls


def house(
    build: Builder,
    palette: Palette,
    place: Place,
    plan: Facade,
    front: int,
    depth: float,
    roof_steps: int | None = None,
) -> None:
    """A house whose front is at `place`, facing -y.

    `depth`: metres. `roof_steps`: number of courses of boxes of a roof up to its ridge; None for a
    few low ones, which are enough for views from the street.
    """
    walls = {"brick": palette.bricks, "concrete": palette.concrete}
    coat = walls.get(plan.wall) or int(build.rng.choice(palette.coats))
    body = (plan.width, depth, plan.height)
    build.add(place.at(0, depth / 2, plan.height / 2), body, coat, place.yaw, 90.0, stain=0.3)
    skin = (plan.width - 0.02, _SKIN_M, plan.height - 0.02)
    at = place.at(0, _SKIN_M / 2 - _OUT_M, plan.height / 2)
    build.add(at, skin, front, place.yaw, None)
    _roof(build, palette, place, plan, depth, roof_steps)
    _ledges(build, palette, place, plan)
    _entrance(build, palette, place, plan)
    if plan.ground == "shop":
        _shop_front(build, palette, place, plan)
    else:
        _balconies(build, palette, place, plan)
    pipe = (plan.width / 2 - 0.15) * float(build.rng.choice((-1, 1)))
    pipe_size = (0.1, 0.1, plan.height - 0.2)
    at = place.at(pipe, -_OUT_M - 0.09, plan.height / 2)
    build.add(at, pipe_size, palette.metal, place.yaw, 120.0, Kind.CYLINDER)


def _roof(
    build: Builder,
    palette: Palette,
    place: Place,
    plan: Facade,
    depth: float,
    steps: int | None,
) -> None:
    """A cornice, and either a parapet or a steep tiled roof in courses."""
    high = plan.height
    cornice = (plan.width + 0.1, 0.5, 0.28)
    build.add(place.at(0, 0.02, high - 0.05), cornice, palette.kerb, place.yaw, 90.0)
    if steps is not None:
        high += _courses(build, palette, place, plan, (depth, 0.3, 0.5 * depth / steps), steps)
    elif plan.wall == "concrete":
        parapet = (plan.width, depth, 0.4)
        build.add(place.at(0, depth / 2 + 0.1, high + 0.2), parapet, palette.concrete, place.yaw)
    else:
        back, steps = float(build.rng.uniform(0.5, 0.8)), int(build.rng.integers(2, 5))
        _dormers(build, palette, place, plan, high)
        high += _courses(build, palette, place, plan, (depth, 0.7, back), steps)
    for _ in range(int(build.rng.integers(1, 3))):
        x = float(build.rng.uniform(-0.4, 0.4)) * plan.width
        at = place.at(x, depth * 0.45, high + 0.1)
        build.add(at, (0.6, 0.5, 1.8), palette.bricks, place.yaw, 90.0)


def _courses(
    build: Builder,
    palette: Palette,
    place: Place,
    plan: Facade,
    slope: tuple[float, float, float],
    steps: int,
) -> float:
    """Tiles in steps of a `slope` (depth at the eaves, rise, run); returns their height."""
    depth, rise, run = slope
    for k in range(steps):
        size = (plan.width - 0.1, depth - 2 * run * k, rise)
        at = place.at(0, depth / 2, plan.height + rise * (k + 0.5))
        build.add(at, size, palette.tiles, place.yaw, 70.0, stain=0.4)
    return rise * steps


def _dormers(build: Builder, palette: Palette, place: Place, plan: Facade, foot: float) -> None:
    count = int(build.rng.integers(0, 4))
    for k in range(count):
        x = plan.width * ((k + 0.5) / count - 0.5)
        build.add(place.at(x, 1.4, foot + 0.9), (1.3, 2.0, 1.4), palette.coats[0], place.yaw, 90.0)
        build.add(place.at(x, 0.4, foot + 0.95), (0.8, 0.06, 0.9), palette.white, place.yaw)
        build.add(
            place.at(x, 0.37, foot + 0.95), (0.68, 0.06, 0.78), palette.glass, place.yaw, None
        )
        build.add(place.at(x, 1.3, foot + 1.68), (1.6, 2.2, 0.16), palette.tiles, place.yaw, 70.0)


def _ledges(build: Builder, palette: Palette, place: Place, plan: Facade) -> None:
    """Sills below the windows, heads above some, and a band above the ground floor."""
    heads = build.rng.random() < 0.4
    for opening in plan.windows:
        x = opening.x + opening.width / 2 - plan.width / 2
        sill = (opening.width + 0.2, 0.24, 0.07)
        build.add(place.at(x, -0.1, opening.z - 0.03), sill, palette.kerb, place.yaw, 90.0)
        if heads:
            head = (opening.width + 0.3, 0.2, 0.12)
            z = opening.z + opening.height + 0.14
            build.add(place.at(x, -0.08, z), head, palette.kerb, place.yaw, 90.0)
    if plan.floors:
        band = (plan.width, 0.22, 0.16)
        at = place.at(0, -0.06, plan.floors[0] - 0.05)
        build.add(at, band, palette.kerb, place.yaw, 90.0)


def _entrance(build: Builder, palette: Palette, place: Place, plan: Facade) -> None:
    x = plan.door.x + plan.door.width / 2 - plan.width / 2
    build.add(place.at(x, -0.2, 0.07), (1.5, 0.5, 0.14), palette.kerb, place.yaw, 90.0)
    for side in (-0.64, 0.64):
        build.add(place.at(x + side, -0.1, 1.3), (0.16, 0.2, 2.6), palette.kerb, place.yaw, 90.0)
    roof = (1.7, 0.9, 0.12)
    build.add(place.at(x, -0.4, 2.72), roof, palette.metal, place.yaw, 90.0)


def _shop_front(build: Builder, palette: Palette, place: Place, plan: Facade) -> None:
    """A name above the windows, and often an awning and a hanging sign."""
    long = min(plan.width - 1.0, float(build.rng.uniform(3.5, 7.0)))
    x = float(build.rng.uniform(-0.5, 0.5)) * (plan.width - long - 0.6)
    name = int(build.rng.choice(palette.shop_signs))
    build.add(place.at(x, -0.14, 3.15), (long, 0.2, 0.55), name, place.yaw, None)
    if build.rng.random() < 0.6:
        for k in range(3):  # a sloping awning, in three folds
            at = place.at(x, -0.35 - 0.4 * k, 2.82 - 0.1 * k)
            build.add(at, (long, 0.42, 0.12), int(build.rng.choice(palette.coats)), place.yaw, 60.0)
    if build.rng.random() < 0.6:
        side = (plan.width / 2 - 0.5) * float(build.rng.choice((-1, 1)))
        sign = int(build.rng.choice(palette.signs))
        build.add(place.at(side, -0.55, 3.4), (0.1, 0.8, 0.8), sign, place.yaw, None)


def _balconies(build: Builder, palette: Palette, place: Place, plan: Facade) -> None:
    if len(plan.floors) < 2 or build.rng.random() < 0.45:
        return
    column = float(build.rng.choice([w.x + w.width / 2 for w in plan.windows])) - plan.width / 2
    x = float(np.clip(column, 1.6 - plan.width / 2, plan.width / 2 - 1.6))
    for z in plan.floors:
        build.add(place.at(x, -0.6, z + 0.02), (2.8, 1.15, 0.18), palette.concrete, place.yaw, 90.0)
        build.add(place.at(x, -1.14, z + 1.12), (2.8, 0.06, 0.06), palette.metal, place.yaw, 90.0)
        if build.rng.random() < 0.5:
            at = place.at(x, -1.14, z + 0.6)
            build.add(at, (2.78, 0.05, 0.85), palette.coats[1], place.yaw, 90.0)
        else:
            for k in range(12):
                at = place.at(x - 1.37 + 0.249 * k, -1.14, z + 0.6)
                build.add(at, (0.03, 0.03, 1.0), palette.metal, place.yaw, 90.0)
        for side in (-1.37, 1.37):
            at = place.at(x + side, -0.58, z + 0.6)
            build.add(at, (0.05, 1.06, 0.85), palette.coats[1], place.yaw, 90.0)
