"""Walls with openings, and fittings of the walls of an office corridor.

In the frame of a wall, x is along it, -y out of it, y into it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.scene.solids import Kind, Solid
from data_synth.worlds import indoor_textures, prints, textures

WALL_M = 0.3
DOOR_M = (0.96, 2.1)
NICHE_M = (1.7, 2.2, 0.6)
_WALL_DENSITY = 200.0


@dataclass(frozen=True)
class Kit:
    """Numbers of the textures of a corridor."""

    paint: int
    dado: int
    doors: tuple[int, ...]
    frame: int
    metal: int
    dark: int
    heater: int
    views: tuple[int, ...]
    boards: tuple[int, ...]
    posters: tuple[int, ...]
    machines: tuple[int, ...]
    leaves: tuple[int, ...]
    red: int
    exit_sign: int
    cushion: int


def make_kit(build: Builder) -> Kit:
    """Paint the textures; shades and doors depend on the seed."""
    rng = build.rng
    wall, wood = float(rng.uniform(0.62, 0.74)), float(rng.uniform(0.3, 0.55))
    darker = float(rng.choice((0.0, 0.14, 0.22)))
    paint = build.paint(partial(indoor_textures.paint, shade=wall), (1024, 2048))
    dado = partial(indoor_textures.paint, shade=wall - darker)
    return Kit(
        paint=paint,
        dado=build.paint(dado, (1024, 2048)) if darker > 0.0 else paint,
        doors=tuple(
            build.paint(partial(prints.door_leaf, shade=wood + 0.04 * i), (512, 256))
            for i in range(3)
        ),
        frame=build.paint(partial(indoor_textures.steel, shade=float(rng.uniform(0.25, 0.5)))),
        metal=build.paint(partial(indoor_textures.steel, shade=0.62)),
        dark=build.paint(partial(indoor_textures.steel, shade=0.16), (128, 128)),
        heater=build.paint(prints.radiator, (128, 256)),
        views=tuple(build.paint(prints.view_outside, (256, 256)) for _ in range(4)),
        boards=tuple(build.paint(prints.notices, (512, 1024)) for _ in range(3)),
        posters=tuple(build.paint(textures.poster, (256, 256)) for _ in range(5)),
        machines=tuple(build.paint(prints.machine, (512, 256)) for _ in range(2)),
        leaves=tuple(build.paint(indoor_textures.foliage, (256, 256)) for _ in range(2)),
        red=build.paint(prints.extinguisher, (128, 128)),
        exit_sign=build.paint(prints.pictogram, (128, 256)),
        cushion=build.paint(textures.fabric, (256, 256)),
    )


@dataclass
class Wall:
    """A straight wall, centred at x = 0; shift_m is the offset of its paint."""

    build: Builder
    kit: Kit
    place: Place
    height_m: float
    dado_m: float
    shift_m: float

    def slab(
        self, x: tuple[float, float], z: tuple[float, float], y: float = 0.0, thick: float = WALL_M
    ) -> None:
        """A piece of wall with its front at y; the paint continues from piece to piece."""
        pieces = [(self.kit.dado, z[0], min(z[1], self.dado_m))]
        pieces.append((self.kit.paint, max(z[0], self.dado_m), z[1]))
        for texture, low, high in pieces:
            if high - low > 1e-6:
                along, up = (x[0] + x[1]) / 2, (low + high) / 2
                self.build.solids.append(
                    Solid(
                        self.place.at(along, y + thick / 2, up),
                        (x[1] - x[0], thick, high - low),
                        texture,
                        self.place.yaw,
                        _WALL_DENSITY,
                        (_WALL_DENSITY * (along + self.shift_m), -_WALL_DENSITY * up),
                    )
                )

    def skirting(self, start: float, stop: float) -> None:
        """Skirting along a piece of wall."""
        size = (stop - start, 0.016, 0.1)
        self.box(((start + stop) / 2, -0.008, 0.05), size, self.kit.frame)

    def box(
        self,
        centre: tuple[float, float, float],
        size: tuple[float, float, float],
        texture: int,
        density: float | None = 260.0,
        kind: Kind = Kind.BOX,
    ) -> None:
        """A solid in the frame of the wall."""
        at = self.place.at(*centre)
        self.build.add(at, size, texture, self.place.yaw, density, kind)

    def plain(self, start: float, stop: float) -> None:
        """Wall without openings."""
        self.slab((start, stop), (0.0, self.height_m))
        self.skirting(start, stop)

    def around(self, start: float, stop: float, opening: tuple[float, float, float, float]) -> None:
        """Wall from start to stop about an opening (left, right, sill, head)."""
        left, right, sill, head = opening
        for piece in ((start, left), (right, stop)):
            if piece[1] - piece[0] > 1e-6:
                self.plain(*piece)
        self.slab((left, right), (head, self.height_m))
        if sill > 0.0:
            self.slab((left, right), (0.0, sill))
            self.skirting(left, right)


def door(wall: Wall, start: float, stop: float, number: str, leaf: int) -> None:
    """A door set back in its frame, with a handle and a plate beside it."""
    middle, (width, height), kit = (start + stop) / 2, DOOR_M, wall.kit
    left, right = middle - width / 2, middle + width / 2
    wall.around(start, stop, (left, right, 0.0, height))
    wall.box((middle, 0.09, height / 2), (width, 0.05, height), kit.doors[leaf], None)
    for x in (left, right):
        wall.box((x, 0.01, height / 2), (0.07, 0.07, height), kit.frame)
    wall.box((middle, 0.01, height + 0.035), (width + 0.07, 0.07, 0.07), kit.frame)
    wall.box((left + 0.1, 0.058, 1.04), (0.045, 0.014, 0.24), kit.metal)
    wall.box((left + 0.15, 0.028, 1.06), (0.14, 0.022, 0.022), kit.metal)
    for z in (0.35, 1.75):
        wall.box((right - 0.045, 0.058, z), (0.02, 0.02, 0.12), kit.dark)
    plate = wall.build.paint(partial(prints.sign, text=number), (64, 128))
    wall.box((left - 0.24, -0.006, 1.56), (0.2, 0.012, 0.12), plate, None)
    wall.box((left - 0.2, -0.006, 1.08), (0.09, 0.014, 0.09), kit.metal)


def window(wall: Wall, start: float, stop: float, view: int) -> None:
    """A window with a sash bar in a deep reveal over a radiator."""
    middle, kit, sill, head = (start + stop) / 2, wall.kit, 0.92, 2.25
    half = min(1.1, (stop - start) / 2 - 0.25)
    wall.around(start, stop, (middle - half, middle + half, sill, head))
    wide, high = 2 * half, head - sill
    wall.box((middle, 0.26, (sill + head) / 2), (wide, 0.06, high), kit.views[view], None)
    for x, across in ((-half + 0.03, 0.06), (half - 0.03, 0.06), (0.2 * half, 0.07)):
        wall.box((middle + x, 0.21, (sill + head) / 2), (across, 0.06, high), kit.metal)
    for z in (sill + 0.03, head - 0.03):
        wall.box((middle, 0.205, z), (wide, 0.06, 0.06), kit.metal)
    wall.box((middle, 0.06, sill + 0.015), (wide + 0.12, 0.24, 0.03), kit.metal)
    wall.box((middle, -0.075, 0.47), (1.5 * half, 0.09, 0.56), kit.heater, None)
    for x in (-0.6 * half, 0.6 * half):
        wall.box((middle + x, -0.05, 0.1), (0.025, 0.025, 0.2), kit.metal, kind=Kind.CYLINDER)


def board(wall: Wall, start: float, stop: float) -> None:
    """A notice board between posters, and an extinguisher with its sign."""
    middle, kit, rng = (start + stop) / 2, wall.kit, wall.build.rng
    wall.plain(start, stop)
    texture = int(rng.choice(kit.boards))
    wall.box((middle - 0.1, -0.015, 1.5), (1.5, 0.03, 0.9), texture, None)
    poster = int(rng.choice(kit.posters))
    high = float(rng.uniform(0.5, 0.7))
    wall.box((middle + 1.0, -0.008, 1.55), (0.46, 0.012, high), poster, None)
    if rng.random() < 0.6:
        extinguisher(wall, middle - 1.15)


def extinguisher(wall: Wall, x: float) -> None:
    """A fire extinguisher on its bracket, below its sign."""
    kit = wall.kit
    wall.box((x, -0.1, 0.62), (0.15, 0.15, 0.46), kit.red, None, Kind.CYLINDER)
    wall.box((x, -0.1, 0.86), (0.13, 0.13, 0.12), kit.red, 260.0, Kind.ELLIPSOID)
    wall.box((x, -0.1, 0.94), (0.03, 0.12, 0.06), kit.dark)
    wall.box((x, -0.012, 0.65), (0.1, 0.024, 0.4), kit.metal)
    sign = kit.exit_sign
    wall.box((x, -0.005, 1.75), (0.24, 0.01, 0.13), sign, None)


def niche(wall: Wall, start: float, stop: float) -> None:
    """A recess with a machine, a bench, or plants."""
    middle, (width, height, deep) = (start + stop) / 2, NICHE_M
    left, right = middle - width / 2, middle + width / 2
    wall.around(start, stop, (left, right, 0.0, height))
    wall.slab((left - 0.1, right + 0.1), (0.0, height + 0.1), deep, 0.1)
    for cheek in ((left - 0.1, left), (right, right + 0.1)):
        wall.slab(cheek, (0.0, height), WALL_M, deep - WALL_M)
    over = (middle, (WALL_M + deep) / 2, height + 0.05)
    wall.box(over, (width, deep - WALL_M, 0.1), wall.kit.paint)
    _furnish(wall, middle, deep)


def _furnish(wall: Wall, middle: float, deep: float) -> None:
    kit, rng = wall.kit, wall.build.rng
    picture, machine = int(rng.choice(kit.posters)), int(rng.choice(kit.machines))
    what = int(rng.integers(3))
    if what == 0:
        wall.box((middle - 0.3, 0.33, 0.95), (0.92, 0.5, 1.86), machine, None)
        plant(wall, middle + 0.52, 0.28)
        return
    wall.box((middle, deep - 0.012, 1.6), (0.9, 0.024, 0.65), picture, None)
    if what == 1:
        wall.box((middle, 0.34, 0.43), (1.4, 0.42, 0.08), kit.cushion)
        for x in (-0.6, 0.6):
            wall.box((middle + x, 0.34, 0.195), (0.05, 0.38, 0.39), kit.metal)
    else:
        for x in (-0.45, 0.45):
            plant(wall, middle + x, 0.32)


def plant(wall: Wall, x: float, y: float) -> None:
    """A potted plant of overlapping bushes."""
    kit, rng = wall.kit, wall.build.rng
    leaves = int(rng.choice(kit.leaves))
    wall.box((x, y, 0.18), (0.32, 0.32, 0.36), kit.dark, kind=Kind.CYLINDER)
    wall.box((x, y, 0.52), (0.05, 0.05, 0.4), kit.doors[0], kind=Kind.CYLINDER)
    for i in range(11):
        away, turn = 0.14 * np.sqrt(rng.random()), 2.4 * i
        dx, dy = float(away * np.cos(turn)), float(away * np.sin(turn))
        z, across = 0.5 + 0.07 * i, float(rng.uniform(0.16, 0.26))
        high = float(rng.uniform(0.12, 0.3))
        wall.box((x + dx, y + dy, z), (across, across, high), leaves, 300.0, Kind.ELLIPSOID)
