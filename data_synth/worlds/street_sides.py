"""Sides of streets: rows of houses and gardens, and the verge in front of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.worlds import street_furniture as furniture
from data_synth.worlds import street_plan as layout
from data_synth.worlds.facades import Facade, paint_facade, plan_facade, wall_grain
from data_synth.worlds.houses import house
from data_synth.worlds.palette import Palette
from data_synth.worlds.street_ground import lay_bay, lay_kerb_extension
from data_synth.worlds.street_plan import Frontage
from data_synth.worlds.trees import bush, hedge, tree
from data_synth.worlds.vehicles import Paint, car, van
from vo.base.types import Floats32

_BAY_MIDDLE_M = -layout.PAVEMENT_M - (layout.BAY_M - layout.KERB_M) / 2
_NEAR_KERB_M = -layout.PAVEMENT_M - (layout.BAY_M - layout.KERB_M) + 0.55
_SETBACK_M = 5.0  # of a house behind a front garden


@dataclass(frozen=True, eq=False)
class Fronts:
    """Fronts painted so far; those along the course are not reused."""

    grain: Floats32
    painted: list[tuple[Facade, int]]


def no_fronts(build: Builder) -> Fronts:
    """No painted fronts."""
    return Fronts(wall_grain(build.rng), [])


def row_of_houses(build: Builder, palette: Palette, fronts: Fronts, side: Frontage) -> None:
    """Houses from one end to the other, side by side in a town or apart in gardens."""
    garden_probability = float(build.rng.choice((0.12, 0.12, 0.65)))
    x, end = -side.length / 2 + side.left, side.length / 2 - side.right
    while end - x > 4.0:
        room = end - x
        at_corner = x == -side.length / 2 + side.left or room < 20.0
        if room < 8.5 or (not at_corner and build.rng.random() < 0.14):
            wide = min(room, float(build.rng.uniform(5.0, 8.5)))
            _gap(build, palette, _moved(side.place, x + wide / 2), wide)
        else:
            plan, front = _front(
                build, fronts, min(room, float(build.rng.uniform(9.0, 17.0))), side
            )
            wide = plan.width
            place = _moved(side.place, x + wide / 2)
            if not at_corner and build.rng.random() < garden_probability:
                _garden(build, palette, place, wide)
                place = Place(*place.at(0, _SETBACK_M, 0)[:2], place.yaw)
            house(build, palette, place, plan, front, layout.HOUSE_DEPTH_M)
        x += wide


def _front(build: Builder, fronts: Fronts, width: float, side: Frontage) -> tuple[Facade, int]:
    """A new front along the course; elsewhere a painted one that fits, if there are enough."""
    fitting = [f for f in fronts.painted if f[0].width <= width] if not side.on_loop else []
    if len(fitting) > 6:
        return fitting[int(build.rng.integers(len(fitting)))]
    floors = int(build.rng.choice((2, 2, 3, 3, 4, 5)))
    plan = plan_facade(build.rng, width, floors)
    fronts.painted.append((plan, paint_facade(build, plan, fronts.grain)))
    return fronts.painted[-1]


def verge(build: Builder, palette: Palette, colours: tuple[Paint, ...], side: Frontage) -> None:
    """The strip between road and pavement: parking bays, trees, lamps and signs."""
    reach = side.length / 2 + layout.FRONT_M - layout.CORNER_M
    x, parking = -reach, False
    while x < reach:
        room = reach - x
        long = float(build.rng.uniform(11.0, 19.0) if parking else build.rng.uniform(3.0, 9.0))
        if x == -reach or room < 20.0:  # no parking beside a crossing
            long, parking = (room, False) if room < 20.0 else (8.0, False)
        span = (x, x + long)
        if parking:
            lay_bay(build, palette, side.place, span)
            _parked(build, palette, colours, side.place, span)
        else:
            lay_kerb_extension(
                build, palette, side.place, span, green=bool(build.rng.random() < 0.35)
            )
            _planted(build, palette, side.place, span)
        x, parking = x + long, not parking
    _lamps(build, palette, side)
    _beside_fronts(build, palette, side)


def _moved(place: Place, x: float) -> Place:
    return Place(*place.at(x, 0.0, 0.0)[:2], place.yaw)


def _gap(build: Builder, palette: Palette, place: Place, wide: float) -> None:
    """A gap between houses: a wall or fence or hedge, and trees behind it."""
    _border(build, palette, place, wide)
    for x in np.arange(1.5 - wide / 2, wide / 2 - 1.0, 3.0):
        foot = place.at(float(x), float(build.rng.uniform(3.0, 7.0)), 0.1)
        tree(build, palette, foot, float(build.rng.uniform(5, 10)), 4.2, clumps=16, bare=0.25)
    _border(build, palette, Place(*place.at(0, 10.5, 0)[:2], place.yaw), wide)


def _garden(build: Builder, palette: Palette, place: Place, wide: float) -> None:
    """A front garden with a border and an entrance."""
    opening = float(build.rng.uniform(-0.2, 0.2)) * wide
    for low, high in ((-wide / 2, opening - 0.8), (opening + 0.8, wide / 2)):
        if high - low > 1.0:
            _border(build, palette, _moved(place, (low + high) / 2), high - low)
    for _ in range(int(build.rng.integers(1, 4))):
        x, y = (float(c) for c in build.rng.uniform((-0.42, 1.2), (0.42, 3.6)))
        size = float(build.rng.uniform(0.9, 2.0))
        bush(build, palette, place.at(x * wide, y, 0.1), size, size)
    if build.rng.random() < 0.5:
        foot = place.at(float(build.rng.uniform(-0.35, 0.35)) * wide, 2.4, 0.1)
        tree(build, palette, foot, float(build.rng.uniform(4.0, 6.5)), 3.4, clumps=14, bare=0.28)


def _border(build: Builder, palette: Palette, place: Place, length: float) -> None:
    chance = build.rng.random()
    inset = Place(*place.at(0, 0.4, 0)[:2], place.yaw)
    if chance < 0.4:
        high = float(build.rng.uniform(0.9, 1.7))
        hedge(build, palette, inset.at(0, 0, 0.1), length - 0.2, high, place.yaw)
    elif chance < 0.7:
        furniture.wall(build, palette, inset, length, float(build.rng.uniform(0.7, 1.9)))
    else:
        furniture.wall(build, palette, inset, length, 0.35)
        raised = Place(inset.x, inset.y, inset.yaw)
        furniture.fence(build, palette, raised, length)


def _parked(
    build: Builder,
    palette: Palette,
    colours: tuple[Paint, ...],
    place: Place,
    span: tuple[float, float],
) -> None:
    x = span[0] + 3.0
    while x < span[1] - 2.8:
        if build.rng.random() < 0.78:
            ahead = place.yaw + (np.pi if build.rng.random() < 0.25 else 0.0)
            ahead += float(build.rng.uniform(-0.025, 0.025))
            across = _BAY_MIDDLE_M + float(build.rng.uniform(0.0, 0.15))
            spot = Place(*place.at(x, across, 0.0)[:2], ahead)
            make = van if build.rng.random() < 0.15 else car
            make(build, palette, colours[int(build.rng.integers(len(colours)))], spot)
        x += float(build.rng.uniform(5.6, 6.6))


def _planted(build: Builder, palette: Palette, place: Place, span: tuple[float, float]) -> None:
    """Trees, tubs, posts and signs on a raised part, all well away from the road."""
    for x in np.arange(span[0] + 1.6, span[1] - 1.0, 4.2):
        spot = Place(*place.at(float(x), _BAY_MIDDLE_M + 0.15, 0)[:2], place.yaw)
        chance = build.rng.random()
        if chance < 0.5:
            high, spread = (float(s) for s in build.rng.uniform((5.8, 3.6), (9.0, 4.6)))
            foot = (spot.x, spot.y, layout.PAVED_Z_M - 0.02)
            tree(build, palette, foot, high, spread, clumps=36, bare=0.43)
        elif chance < 0.62:
            furniture.tub(build, palette, spot)
        elif chance < 0.74:
            furniture.cabinet_or_bins(build, palette, spot)
        elif chance < 0.84:
            furniture.bollards(build, palette, spot, 3)
        elif chance < 0.9:
            furniture.advertising_column(build, palette, spot)
        else:
            furniture.road_sign(build, palette, spot)


def _lamps(build: Builder, palette: Palette, side: Frontage) -> None:
    count = max(1, round(side.length / 26.0))
    for k in range(count):
        x = side.length * ((k + 0.5) / count - 0.5) + float(build.rng.uniform(-2, 2))
        at = side.place.at(x, -layout.PAVEMENT_M + 0.45, 0)
        furniture.lamp_post(build, palette, Place(*at[:2], side.place.yaw))
    for x in (-side.length / 2 - 0.4, side.length / 2 + 0.4):
        at = side.place.at(x, _NEAR_KERB_M + 0.6, 0)
        furniture.road_sign(build, palette, Place(*at[:2], side.place.yaw))


def _beside_fronts(build: Builder, palette: Palette, side: Frontage) -> None:
    """Cabinets and bins in front of the houses."""
    for x in np.arange(-side.length / 2 + 3.0, side.length / 2 - 3.0, 9.0):
        if build.rng.random() < 0.4:
            at = side.place.at(float(x + build.rng.uniform(-2, 2)), -0.75, 0)
            furniture.cabinet_or_bins(build, palette, Place(*at[:2], side.place.yaw + np.pi))
