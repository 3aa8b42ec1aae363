"""World: an office corridor round a core: long, repetitive, and bare in places."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from data_synth.scene.builder import Builder, Place, Rng
from data_synth.scene.lighting import bake_lighting, light_of_session
from data_synth.scene.scene import Body, Course, Scene, flat_ground
from data_synth.scene.solids import Kind, Lamp, Lighting, Solid
from data_synth.worlds import bodies, fittings, indoor_textures, prints
from data_synth.worlds.fittings import Wall
from vo.base.types import Floats

WIDTH_M, HEIGHT_M = 2.4, 2.7
HALF_WIDTH_M = 0.55
_TILE_M = 0.6
_MODULE_M = 3.0
_LAMP_STEP_M = 3.6
_DADO_M = 1.05
_END_M = 0.9  # bare end of each wall of the core
_ASIDE_M = 0.66  # distance of people from the middle
_USUAL_PEOPLE = 5
_WHITE = 0.85


@dataclass(frozen=True)
class _Plan:
    """Size of the loop, and content of each module of the walls."""

    long_m: float  # length of the centre line of sides 0 and 2
    short_m: float  # the same of sides 1 and 3
    inner: tuple[tuple[str, ...], ...]
    outer: tuple[tuple[str, ...], ...]

    def along(self, side: int) -> float:
        """Length of a side's centre line."""
        return self.long_m if side % 2 == 0 else self.short_m

    def away(self, side: int) -> float:
        """Distance of a side's centre line from the middle."""
        return (self.short_m if side % 2 == 0 else self.long_m) / 2


def make_scene(seed: int, movers: float = 0.0, session: int = 0, *, white: bool = False) -> Scene:
    """A closed loop of corridor of about 30 x 18 m, 2.4 m wide and 2.7 m high.

    Doors repeat at equal distances; a stretch of 6 m to 9 m on one long side is bare. White walls
    have nothing on them, and no grain.
    """
    build = Builder(np.random.default_rng([seed, 31]))
    plan = _plan(build.rng)
    kit = fittings.make_kit(build)
    if white:
        plan = replace(plan, inner=_all_plain(plan.inner), outer=_all_plain(plan.outer))
        even = build.paint(lambda _, shape: np.full(shape, _WHITE, np.float32))
        kit = replace(kit, paint=even, dado=even)
    _shell(build, plan)
    for side in range(4):
        _side(build, kit, plan, side)
    lamps = _lamps(build, plan) + _daylight(plan)
    course = Course(_loop(plan), HALF_WIDTH_M, 2.3, flat_ground(), view_yaw_deg=-15.0)
    people = _people(build, plan, round(_USUAL_PEOPLE * movers))
    light = Lighting(lamps, ambient=0.68, points_per_m=4.0, max_points=200)
    light = light_of_session(light, seed, session)
    return Scene(bake_lighting(build.world(), light), course, people)


def _all_plain(walls: tuple[tuple[str, ...], ...]) -> tuple[tuple[str, ...], ...]:
    return tuple(("plain",) * len(modules) for modules in walls)


def _plan(rng: Rng) -> _Plan:
    long_m, short_m = (2 * _TILE_M * int(n) for n in rng.integers((23, 14), (28, 17)))
    counts = [int((m - WIDTH_M - 2 * _END_M) / _MODULE_M) for m in (long_m, short_m)] * 2
    inner = [_inner_modules(rng, n) for n in counts]
    bright = int(rng.integers(4))  # first of the two sides with windows
    outer = [_outer_modules(rng, n, (i - bright) % 4 < 2) for i, n in enumerate(counts)]
    bare, length = 2 * int(rng.integers(2)), int(rng.integers(2, 4))
    first = int(rng.integers(1, counts[bare] - length))
    for walls in (inner, outer):
        walls[bare][first : first + length] = ["plain"] * length
    return _Plan(long_m, short_m, tuple(map(tuple, inner)), tuple(map(tuple, outer)))


def _inner_modules(rng: Rng, count: int) -> list[str]:
    """Doors in a fixed rhythm, with exceptions."""
    rhythm = [("door", "door", "board"), ("door", "plain"), ("door", "board")][int(rng.integers(3))]
    kinds = [rhythm[i % len(rhythm)] for i in range(count)]
    for i in range(count):
        if rng.random() < 0.15:
            kinds[i] = str(rng.choice(("niche", "board", "plain")))
    return kinds


def _outer_modules(rng: Rng, count: int, bright: bool) -> list[str]:
    usual = (
        ("window", "window", "window", "niche") if bright else ("door", "board", "niche", "door")
    )
    return [str(rng.choice(usual)) for _ in range(count)]


def _shell(build: Builder, plan: _Plan) -> None:
    """Floor and ceiling, of one piece each, as the core hides the rest."""
    long, deep = plan.long_m + WIDTH_M + 2.0, plan.short_m + WIDTH_M + 2.0
    painters = (indoor_textures.linoleum, indoor_textures.carpet)
    floor = build.paint(painters[int(build.rng.integers(2))], (2048, 2048))
    build.add((0, 0, -0.15), (long, deep, 0.3), floor, density=210.0, stain=0.5)
    tiles = build.paint(indoor_textures.ceiling_tiles, (1024, 1024))
    density = indoor_textures.CEILING_TILE_PX / _TILE_M
    # Without offset, because the lamps are aligned with the tiles.
    centre, size = (0.0, 0.0, HEIGHT_M + 0.15), (long, deep, 0.3)
    build.solids.append(Solid(centre, size, tiles, density=density, stain=0.2))


def _side(build: Builder, kit: fittings.Kit, plan: _Plan, side: int) -> None:
    yaw, away = side * np.pi / 2, plan.away(side)
    core = plan.along(side) - WIDTH_M
    shifts = (float(s) for s in build.rng.uniform(0.0, 10.0, 2))
    outer, inner = (
        Wall(build, kit, _placed(away + out * WIDTH_M / 2, yaw, turn), HEIGHT_M, _DADO_M, shift)
        for out, turn, shift in zip((1, -1), (0.0, np.pi), shifts, strict=True)
    )
    _modules(inner, plan.inner[side], core, core / 2, side)
    _modules(outer, plan.outer[side], core, core / 2 + WIDTH_M + fittings.WALL_M, side + 4)
    corner = (core / 2 + WIDTH_M - 0.25, -0.25)
    if build.rng.random() < 0.7:
        fittings.plant(outer, *corner)
    else:
        fittings.extinguisher(outer, corner[0] - 0.3)
    # Guards hide the overlap of two walls in a corner.
    inner.box((core / 2 - 0.16, 0.16, HEIGHT_M / 2), (0.34, 0.34, HEIGHT_M), kit.frame)
    outer.box((0.0, -0.03, HEIGHT_M - 0.16), (core + 2 * WIDTH_M, 0.06, 0.09), kit.metal)
    if side % 2 == 0:
        _portal(outer, core / 2 - 0.4)


def _placed(away: float, yaw: float, turn: float) -> Place:
    return Place(float(-np.sin(yaw) * away), float(np.cos(yaw) * away), yaw + turn)


def _modules(wall: Wall, kinds: tuple[str, ...], core: float, end: float, floor: int) -> None:
    """Build a wall module by module between two bare ends."""
    rng = wall.build.rng
    start, step = _grid(core, len(kinds))
    wall.plain(-end, start)
    wall.plain(-start, end)
    for i, kind in enumerate(kinds):
        left, right = start + i * step, start + (i + 1) * step
        if kind == "door":
            number = f"{floor + 1}{i + 1:02d}"
            fittings.door(wall, left, right, number, int(rng.integers(len(wall.kit.doors))))
        elif kind == "window":
            fittings.window(wall, left, right, int(rng.integers(len(wall.kit.views))))
        elif kind == "board":
            fittings.board(wall, left, right)
        elif kind == "niche":
            fittings.niche(wall, left, right)
        else:
            wall.plain(left, right)


def _portal(outer: Wall, x: float) -> None:
    """A fire-door frame across the corridor, under an exit sign."""
    for y in (-0.07, 0.07 - WIDTH_M):
        outer.box((x, y, HEIGHT_M / 2), (0.16, 0.14, HEIGHT_M), outer.kit.frame)
    across = WIDTH_M - 0.28
    outer.box((x, -WIDTH_M / 2, HEIGHT_M - 0.17), (0.16, across, 0.34), outer.kit.frame)
    outer.box((x, -WIDTH_M / 2, 0.0), (0.12, across, 0.008), outer.kit.metal)
    sign = outer.place.at(x, -WIDTH_M / 2, HEIGHT_M - 0.17)
    build, yaw = outer.build, outer.place.yaw + np.pi / 2
    build.add(sign, (0.4, 0.2, 0.2), outer.kit.exit_sign, yaw, None)


def _lamps(build: Builder, plan: _Plan) -> tuple[Lamp, ...]:
    """Lamp panels in the tiles at equal distances, with a detector or vent between some."""
    bright = build.paint(prints.lamp_panel, (128, 256))
    vent = build.paint(prints.radiator, (64, 64))
    lamps = []
    for side in range(4):
        yaw = side * np.pi / 2
        line = _placed(plan.away(side), yaw, 0.0)
        count = int((plan.along(side) - WIDTH_M) / _LAMP_STEP_M)
        for i in range(count + 1):
            x = (i - count / 2) * _LAMP_STEP_M + _TILE_M / 2
            power = float(build.rng.uniform(0.45, 0.6))
            size = (_TILE_M, 2 * _TILE_M, 0.04)
            build.add(line.at(x, 0.0, HEIGHT_M - 0.005), size, bright, yaw, None)
            lamps.append(Lamp(line.at(x, 0.0, HEIGHT_M - 0.1), power, 2.6))
            if build.rng.random() < 0.5:
                at = line.at(x + 3 * _TILE_M, 0.3, HEIGHT_M - 0.02)
                build.add(at, (0.14, 0.14, 0.07), vent, yaw, kind=Kind.CYLINDER)
            else:
                at = line.at(x + 3 * _TILE_M, -0.3, HEIGHT_M)
                build.add(at, (0.56, 0.56, 0.02), vent, yaw, None)
    return tuple(lamps)


def _daylight(plan: _Plan) -> tuple[Lamp, ...]:
    """Light just inside each window, which brightens the pane too."""
    found = []
    for side in range(4):
        wall = _placed(plan.away(side) + WIDTH_M / 2, side * np.pi / 2, 0.0)
        start, step = _grid(plan.along(side) - WIDTH_M, len(plan.outer[side]))
        for i, kind in enumerate(plan.outer[side]):
            if kind == "window":
                found.append(Lamp(wall.at(start + (i + 0.5) * step, -0.05, 1.65), 0.45, 1.1, 0.8))
    return tuple(found)


def _grid(core: float, count: int) -> tuple[float, float]:
    """Start of the first module of a wall, and width of each."""
    return -core / 2 + _END_M, (core - 2 * _END_M) / count


def _loop(plan: _Plan) -> Floats:
    """The corners of the loop's centre line, counter-clockwise."""
    x, y = plan.long_m / 2, plan.short_m / 2
    return np.array([[x, y], [-x, y], [-x, -y], [x, -y]])


def _people(build: Builder, plan: _Plan, count: int) -> tuple[Body, ...]:
    """People on the right-hand side, in both directions."""
    people = []
    for i in range(count):
        route = bodies.beside(_loop(plan)[:: int(build.rng.choice((-1, 1)))], -_ASIDE_M)
        radius = bodies.person(build, i)
        speed, start = float(build.rng.uniform(0.9, 1.5)), float(build.rng.random())
        people.append(Body(f"person {i}", route, speed, start, radius))
    return tuple(people)
