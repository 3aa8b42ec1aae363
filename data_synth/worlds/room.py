"""World: a furnished room."""

from __future__ import annotations

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.scene.lighting import bake_lighting, light_of_session
from data_synth.scene.scene import Body, Course, Scene, flat_ground
from data_synth.scene.solids import Lamp, Lighting
from data_synth.worlds import bodies, textures

WIDTH_M, DEPTH_M, HEIGHT_M = 9.0, 7.0, 2.9
_WALL_DENSITY = 220.0
_SHELL_M = 0.3
_LIGHT = Lighting(lamps=(Lamp((0.4, 0.25, 2.45)),))

# Round the table, with half a metre to either side.
_COURSE = ((1.6, 0.6), (0.9, 1.35), (-0.9, 1.35), (-1.6, 0.6))
# Between the course and the furniture, at both ends of the room: x, then y.
_PACING_M = (((2.75, 3.3), (-1.2, 1.2)), ((-3.3, -2.75), (-1.4, 1.0)))
_USUAL_PEOPLE = 2


def make_scene(seed: int, movers: float = 0.0, session: int = 0) -> Scene:
    """A room of 9 x 7 x 2.9 m, with people who pace up and down at its ends.

    Its floor is at z = 0 and its middle at the origin. Furniture stands along the walls and in the
    middle; a ring of 1.2 m to 2.3 m around the origin is free to walk in.
    """
    build = _furnished(seed)
    half = np.array(_COURSE)
    course = Course(np.vstack([half, -half]), 0.5, 2.5, flat_ground(), view_yaw_deg=-25.0)
    people = _people(build, round(_USUAL_PEOPLE * movers))
    light = light_of_session(_LIGHT, seed, session)
    return Scene(bake_lighting(build.world(), light), course, people)


def _people(build: Builder, count: int) -> tuple[Body, ...]:
    people = []
    for i in range(count):
        (left, right), (low, high) = _PACING_M[i % len(_PACING_M)]
        route = np.array([[right, low], [right, high], [left, high], [left, low]])
        radius = bodies.person(build, i)
        speed, start = float(build.rng.uniform(0.5, 0.9)), float(build.rng.random())
        people.append(Body(f"person {i}", route, speed, start, radius))
    return tuple(people)


def _furnished(seed: int) -> Builder:
    build = Builder(np.random.default_rng(seed))
    _shell(build)
    _wall_decorations(build)
    wood = [build.paint(textures.wood) for _ in range(3)]
    cloth = [build.paint(textures.fabric) for _ in range(3)]
    spines = [build.paint(textures.books, (128, 512)) for _ in range(4)]
    cartons = [build.paint(textures.carton) for _ in range(3)]
    north, south, east, west = DEPTH_M / 2, -DEPTH_M / 2, WIDTH_M / 2, -WIDTH_M / 2
    _shelf(build, Place(-2.6, north, 0.0), wood[0], spines)
    _sofa(build, Place(0.3, north, 0.0), cloth[0], cloth[1])
    _cabinet(build, Place(3.1, north, 0.0), wood[1], cartons)
    _shelf(build, Place(east, 1.3, -np.pi / 2), wood[2], spines)
    _desk(build, Place(east, -1.6, -np.pi / 2), wood[0], cartons, spines)
    _sofa(build, Place(2.0, south, np.pi), cloth[2], cloth[0])
    _shelf(build, Place(-0.9, south, np.pi), wood[1], spines)
    _cartons(build, Place(-3.3, south, np.pi), cartons)
    _cabinet(build, Place(west, -0.9, np.pi / 2), wood[2], cartons)
    _cartons(build, Place(west, 1.5, np.pi / 2), cartons)
    _table(build, Place(0.0, 0.0, 0.12), wood[1], cartons, spines)
    for x, y, yaw in ((-3.0, 2.2, 0.5), (3.1, 2.1, 2.6), (3.2, -2.4, 0.9)):
        _chair(build, Place(x, y, yaw), wood[0], cloth[1])
    return build


def _shell(build: Builder) -> None:
    half, x, y, z = _SHELL_M / 2, WIDTH_M / 2, DEPTH_M / 2, HEIGHT_M
    long, deep, high = WIDTH_M + 2 * _SHELL_M, DEPTH_M + 2 * _SHELL_M, HEIGHT_M
    floor = build.paint(textures.planks, (2048, 2048))
    build.add((0, 0, -half), (long, deep, _SHELL_M), floor, density=_WALL_DENSITY)
    panels = build.paint(textures.ceiling, (1024, 1024))
    build.add((0, 0, z + half), (long, deep, _SHELL_M), panels, density=140.0)
    for painter, centre, size in (
        (textures.plaster, (0, y + half, z / 2), (long, _SHELL_M, high)),
        (textures.bricks, (x + half, 0, z / 2), (_SHELL_M, deep, high)),
        (textures.plaster, (0, -y - half, z / 2), (long, _SHELL_M, high)),
        (textures.plaster, (-x - half, 0, z / 2), (_SHELL_M, deep, high)),
    ):
        texture = build.paint(painter, (1024, 2048))
        build.add(centre, size, texture, density=_WALL_DENSITY)


def _wall_decorations(build: Builder) -> None:
    """Posters and skirting on all walls, a rug on the floor and beams below the ceiling."""
    wood = build.paint(textures.wood)
    for wall in range(4):
        yaw = wall * np.pi / 2
        along, away = (WIDTH_M, DEPTH_M) if wall % 2 == 0 else (DEPTH_M, WIDTH_M)
        place = Place(*_turned(0.0, away / 2, yaw), yaw)
        build.add(place.at(0, -0.01, 0.05), (along, 0.02, 0.1), wood, yaw)
        spots = np.linspace(-along / 2 + 0.7, along / 2 - 0.7, 6 if wall % 2 == 0 else 5)
        for spot in spots + build.rng.uniform(-0.2, 0.2, len(spots)):
            _poster(build, place, float(spot))
    rug = build.paint(textures.rug)
    build.add((0.1, 0.0, 0.006), (4.4, 3.2, 0.012), rug, 0.05, density=None)
    for x in (-3.0, -1.0, 1.0, 3.0):
        build.add((x, 0, HEIGHT_M - 0.08), (0.16, DEPTH_M, 0.16), wood)


def _turned(x: float, y: float, yaw: float) -> tuple[float, float]:
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return float(cosine * x - sine * y), float(sine * x + cosine * y)


def _poster(build: Builder, place: Place, spot: float) -> None:
    width, height = (float(s) for s in build.rng.uniform((0.4, 0.4), (0.85, 0.75)))
    texture = build.paint(textures.poster, (256, 256))
    z = float(build.rng.uniform(1.75, 2.2))
    build.add(place.at(spot, -0.015, z), (width, 0.03, height), texture, place.yaw, None)


def _shelf(build: Builder, place: Place, wood: int, spines: list[int]) -> None:
    width, depth, boards = 1.5, 0.34, 5
    height = boards * 0.36
    for x in (-width / 2, width / 2):
        build.add(place.at(x, -depth / 2, height / 2), (0.04, depth, height), wood, place.yaw)
    build.add(place.at(0, -0.02, height / 2), (width, 0.02, height), wood, place.yaw)
    for board in range(boards + 1):
        z = 0.04 + board * (height - 0.04) / boards
        build.add(place.at(0, -depth / 2, z), (width, depth, 0.03), wood, place.yaw)
        if board < boards:
            _book_row(build, place, z + 0.015, width, depth, spines)


def _book_row(
    build: Builder, place: Place, z: float, width: float, depth: float, spines: list[int]
) -> None:
    x = -width / 2 + 0.05
    while x < width / 2 - 0.3:
        length = float(build.rng.uniform(0.16, 0.34))
        height, deep = (float(s) for s in build.rng.uniform((0.18, 0.16), (0.29, depth - 0.05)))
        texture = int(build.rng.choice(spines))
        centre = place.at(x + length / 2, -0.04 - deep / 2, z + height / 2)
        build.add(centre, (length, deep, height), texture, place.yaw, density=420.0)
        x += length + float(build.rng.uniform(0.01, 0.12))


def _sofa(build: Builder, place: Place, body: int, cushion: int) -> None:
    build.add(place.at(0, -0.45, 0.2), (2.0, 0.85, 0.4), body, place.yaw)
    build.add(place.at(0, -0.13, 0.6), (2.0, 0.22, 0.42), body, place.yaw)
    for x in (-1.0, 1.0):
        build.add(place.at(x, -0.45, 0.31), (0.2, 0.85, 0.62), body, place.yaw)
    for x in (-0.55, 0.1, 0.6):
        turn = place.yaw + float(build.rng.uniform(-0.3, 0.3))
        build.add(place.at(x, -0.33, 0.56), (0.42, 0.14, 0.32), cushion, turn)


def _cabinet(build: Builder, place: Place, wood: int, cartons: list[int]) -> None:
    build.add(place.at(0, -0.25, 0.48), (1.3, 0.5, 0.96), wood, place.yaw)
    for x in (-0.32, 0.32):
        for z in (0.26, 0.7):
            build.add(place.at(x, -0.505, z), (0.58, 0.02, 0.38), wood, place.yaw)
            build.add(place.at(x, -0.525, z + 0.1), (0.14, 0.02, 0.02), wood, place.yaw)
    _pile(build, place, (0.0, -0.25, 0.96), 3, cartons, 0.28)


def _desk(build: Builder, place: Place, wood: int, cartons: list[int], spines: list[int]) -> None:
    build.add(place.at(0, -0.4, 0.73), (1.6, 0.8, 0.04), wood, place.yaw)
    build.add(place.at(0.55, -0.4, 0.36), (0.42, 0.7, 0.7), wood, place.yaw)
    build.add(place.at(-0.75, -0.4, 0.36), (0.05, 0.7, 0.7), wood, place.yaw)
    screen = build.paint(textures.poster, (256, 256))
    build.add(place.at(-0.1, -0.3, 1.05), (0.62, 0.04, 0.38), screen, place.yaw + 0.15, None)
    build.add(place.at(-0.1, -0.27, 0.81), (0.08, 0.08, 0.14), wood, place.yaw)
    _pile(build, place, (0.5, -0.35, 0.75), 2, cartons, 0.22)
    build.add(place.at(-0.6, -0.2, 0.87), (0.3, 0.2, 0.24), spines[0], place.yaw, 420.0)


def _cartons(build: Builder, place: Place, cartons: list[int]) -> None:
    for x in (-0.55, 0.1, 0.7):
        _pile(build, place, (x, -0.42, 0.0), int(build.rng.integers(2, 4)), cartons, 0.5)


def _pile(
    build: Builder,
    place: Place,
    base: tuple[float, float, float],
    count: int,
    cartons: list[int],
    side: float,
) -> None:
    x, y, z = base
    for _ in range(count):
        size = tuple(float(s) for s in side * build.rng.uniform((0.9, 0.8, 0.5), (1.2, 1.0, 0.9)))
        turn = place.yaw + float(build.rng.uniform(-0.25, 0.25))
        texture = int(build.rng.choice(cartons))
        build.add(place.at(x, y, z + size[2] / 2), (size[0], size[1], size[2]), texture, turn)
        z += size[2]


def _table(build: Builder, place: Place, wood: int, cartons: list[int], spines: list[int]) -> None:
    build.add(place.at(0, 0, 0.72), (1.2, 0.8, 0.04), wood, place.yaw)
    for x in (-0.54, 0.54):
        for y in (-0.34, 0.34):
            build.add(place.at(x, y, 0.35), (0.06, 0.06, 0.7), wood, place.yaw)
    _pile(build, place, (-0.3, 0.1, 0.74), 2, cartons, 0.24)
    build.add(place.at(0.3, -0.1, 0.80), (0.3, 0.22, 0.12), spines[1], place.yaw + 0.4, 420.0)
    build.add(place.at(0.35, 0.2, 0.765), (0.22, 0.3, 0.05), spines[2], place.yaw - 0.3, 420.0)


def _chair(build: Builder, place: Place, wood: int, cloth: int) -> None:
    build.add(place.at(0, -0.22, 0.45), (0.44, 0.44, 0.05), cloth, place.yaw)
    build.add(place.at(0, -0.02, 0.75), (0.42, 0.04, 0.4), cloth, place.yaw)
    for x in (-0.19, 0.19):
        for y, top in ((-0.41, 0.43), (-0.02, 0.95)):
            build.add(place.at(x, y, top / 2), (0.04, 0.04, top), wood, place.yaw)
