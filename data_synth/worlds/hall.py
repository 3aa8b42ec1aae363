"""The hall of a warehouse: floor, walls with loading doors, roof with girders, lamps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.scene.solids import Kind, Lamp
from data_synth.worlds import indoor_textures, prints

LENGTH_M, DEPTH_M, HEIGHT_M = 40.0, 27.0, 7.4
_SHELL_M = 0.3
_LAMP_Z = 6.1
_TRUSS_STEP_M = 5.0
_DOORS_Y = (-8.0, -4.0, 0.0, 4.0, 8.0)


def shell(build: Builder) -> None:
    """Floor, walls and roof."""
    half, long, deep = _SHELL_M / 2, LENGTH_M + 2 * _SHELL_M, DEPTH_M + 2 * _SHELL_M
    floor = build.paint(indoor_textures.concrete, (2048, 2048))
    build.add((0, 0, -half), (long, deep, _SHELL_M), floor, density=165.0, stain=0.6)
    sheet = build.paint(indoor_textures.corrugated, (1024, 1024))
    build.add((0, 0, HEIGHT_M + half), (long, deep, _SHELL_M), sheet, density=100.0, stain=0.4)
    plinth = build.paint(partial(indoor_textures.concrete, shade=0.56), (1024, 1024))
    for wall in range(4):
        yaw = wall * np.pi / 2
        along, away = (LENGTH_M, DEPTH_M) if wall % 2 == 0 else (DEPTH_M, LENGTH_M)
        place = Place(float(-np.sin(yaw) * away / 2), float(np.cos(yaw) * away / 2), yaw)
        size = (along, _SHELL_M, HEIGHT_M)
        build.add(place.at(0, half, HEIGHT_M / 2), size, sheet, yaw, 120.0, stain=0.5)
        build.add(place.at(0, -0.02, 0.6), (along, 0.16, 1.2), plinth, yaw, 180.0, stain=0.5)
        _columns(build, place, along)
    _doors(build, Place(LENGTH_M / 2, 0.0, -np.pi / 2))
    _back_wall(build, Place(-LENGTH_M / 2, 0.0, np.pi / 2))
    _roof(build)


def _columns(build: Builder, place: Place, along: float) -> None:
    """Steel columns, rain pipes and a band of windows high up."""
    steel = build.paint(indoor_textures.steel, (512, 256))
    sky = build.paint(prints.view_outside, (128, 512))
    count = int(along / _TRUSS_STEP_M)
    for i in range(count + 1):
        x = (i - count / 2) * _TRUSS_STEP_M
        size = (0.22, 0.2, HEIGHT_M)
        build.add(place.at(x, -0.1, HEIGHT_M / 2), size, steel, place.yaw, stain=0.3)
        if i < count:
            middle = place.at(x + _TRUSS_STEP_M / 2, -0.03, 6.35)
            build.add(middle, (_TRUSS_STEP_M - 1.2, 0.06, 0.9), sky, place.yaw, None)
        if i % 2 == 0:
            at = place.at(x + 0.35, -0.09, HEIGHT_M / 2)
            build.add(at, (0.11, 0.11, HEIGHT_M), steel, place.yaw, kind=Kind.CYLINDER)


def _doors(build: Builder, place: Place) -> None:
    """Loading doors with their numbers, bumpers and posts."""
    dark = build.paint(partial(indoor_textures.steel, shade=0.15), (128, 128))
    hazard = build.paint(prints.hazard, (64, 128))
    for i, x in enumerate(_DOORS_Y):
        leaf = build.paint(partial(prints.shutter, text=str(i + 1)), (512, 512))
        build.add(place.at(x, -0.09, 1.9), (2.9, 0.1, 3.8), leaf, place.yaw, None)
        for side in (-1.55, 1.55):
            build.add(place.at(x + side, -0.12, 1.95), (0.2, 0.2, 3.9), dark, place.yaw)
            post = place.at(x + side, -0.7, 0.5)
            build.add(post, (0.18, 0.18, 1.0), hazard, 0.0, 120.0, Kind.CYLINDER)
        build.add(place.at(x, -0.12, 3.95), (3.3, 0.24, 0.3), dark, place.yaw)
        plate = build.paint(partial(prints.sign, text=f"DOCK {i + 1}"), (128, 256))
        build.add(place.at(x, -0.03, 4.55), (1.5, 0.06, 0.7), plate, place.yaw, None)


def _back_wall(build: Builder, place: Place) -> None:
    """Cabinets, boards and signs on the wall across from the doors."""
    rng = build.rng
    grey = build.paint(indoor_textures.steel, (256, 256))
    machines = [build.paint(prints.machine, (512, 256)) for _ in range(2)]
    for x in np.arange(-11.5, 11.6, 2.3) + rng.uniform(-0.3, 0.3, 11):
        what, at = int(rng.integers(4)), float(x)
        if what == 0:
            board = build.paint(prints.notices, (256, 512))
            build.add(place.at(at, -0.12, 1.75), (1.5, 0.04, 0.95), board, place.yaw, None)
        elif what == 1:
            size = (0.9, 0.3, float(rng.uniform(1.2, 1.9)))
            build.add(place.at(at, -0.25, 0.15 + size[2] / 2), size, grey, place.yaw)
            front = place.at(at, -0.41, 0.15 + size[2] / 2)
            machine = int(rng.choice(machines))
            build.add(front, (0.8, 0.02, size[2] - 0.1), machine, place.yaw, None)
        elif what == 2:
            text = str(rng.choice(("EXIT", "NO SMOKING", "ZONE 7", "KEEP CLEAR", "FIRE")))
            plate = build.paint(partial(prints.sign, text=text), (128, 256))
            size = (1.2, 0.03, 0.6)
            build.add(place.at(at, -0.02, 2.6), size, plate, place.yaw, None)


def _roof(build: Builder) -> None:
    """Cellular girders across, purlins along, skylights and a duct."""
    steel = build.paint(partial(indoor_textures.steel, shade=0.42), (256, 512))
    girder = build.paint(prints.girder, (128, 128))
    bright = build.paint(prints.view_outside, (128, 512))
    for x in np.arange(-17.5, 17.6, _TRUSS_STEP_M):
        build.add((float(x), 0, 6.95), (0.12, DEPTH_M, 0.75), girder, density=170.0, stain=0.3)
        for z in (6.555, 7.32):
            build.add((float(x), 0, z), (0.24, DEPTH_M, 0.04), steel, stain=0.3)
    for y in (-11.0, -5.5, 0.0, 5.5, 11.0):
        build.add((0, y, 7.35), (LENGTH_M, 0.1, 0.1), steel)
    for y in (-8.1, 2.7):
        for x in (-10.0, 0.0, 10.0):
            build.add((x, y, HEIGHT_M), (4.2, 1.2, 0.08), bright, density=None)
    duct = build.paint(partial(indoor_textures.corrugated, shade=0.6), (256, 256))
    build.add((0, 7.2, 6.2), (36.0, 0.6, 0.5), duct, density=120.0, stain=0.3)


def lamps(build: Builder, lines_y: Sequence[float]) -> tuple[Lamp, ...]:
    """Lamps in rows above the aisles: their solids, and their light."""
    panel = build.paint(prints.lamp_panel, (128, 256))
    steel = build.paint(indoor_textures.steel, (64, 64))
    found = []
    for y in lines_y:
        for x in (-15.0, -7.5, 0.0, 7.5, 15.0):
            build.add((x, y, _LAMP_Z), (1.3, 0.3, 0.1), panel, density=None)
            build.add((x, y, (_LAMP_Z + 6.5) / 2 + 0.1), (0.02, 0.02, 0.5), steel)
            power = float(build.rng.uniform(0.4, 0.5))
            found.append(Lamp((x, y, _LAMP_Z - 0.15), power, 5.0, 0.8))
    return tuple(found)
