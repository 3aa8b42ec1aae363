"""Cars and vans, parked or moving."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from data_synth.scene.builder import Builder, Place, Rng
from data_synth.scene.solids import Kind
from data_synth.worlds.outdoor_textures import title
from data_synth.worlds.palette import Palette
from data_synth.worlds.textures import clipped, noise
from vo.base.types import Floats32

CAR_LENGTH_M, CAR_WIDTH_M = 4.3, 1.76
VAN_LENGTH_M, VAN_WIDTH_M = 5.2, 1.95
RADIUS_M = 2.8  # of an upright cylinder that contains either

_WHEEL_M, _ARCH_M = 0.64, 0.37


@dataclass(frozen=True)
class _SideBox:
    """Box with a painted side: size, height above the road, positions of wheels."""

    length: float
    height: float
    foot: float
    wheels: tuple[float, float]


_CAR_SIDE = _SideBox(CAR_LENGTH_M - 0.3, 0.56, 0.27, (-1.3, 1.3))
_VAN_SIDE = _SideBox(VAN_LENGTH_M - 1.1, 1.86, 0.29, (-1.05, 2.25))


@dataclass(frozen=True)
class Paint:
    """Textures of one colour of car."""

    side: int
    van_side: int
    roof: int
    front: int
    rear: int
    plate: int


def paints(build: Builder, count: int) -> tuple[Paint, ...]:
    """Paint `count` colours, dark to white."""
    colours: list[Paint] = []
    for k in range(count):
        low, high = ((0.05, 0.14), (0.35, 0.5), (0.65, 0.85), (0.14, 0.3))[k % 4]
        shade = float(build.rng.uniform(low, high))
        colours.append(
            Paint(
                side=build.paint(partial(_side, shade, _CAR_SIDE), (64, 512)),
                van_side=build.paint(partial(_side, shade, _VAN_SIDE), (256, 512)),
                roof=build.paint(partial(_lacquer, shade), (64, 64)),
                front=build.paint(partial(_nose, shade, True), (64, 128)),
                rear=build.paint(partial(_nose, shade, False), (64, 128)),
                plate=build.paint(_plate, (32, 128)),
            )
        )
    return tuple(colours)


def _shadow(add: _Adder, palette: Palette, long: float, wide: float) -> None:
    """A dark patch beneath a moving vehicle, which has no baked shadow and would seem to float."""
    if add.body is not None:
        add.box((0, 0, 0.008), (long - 0.3, wide, 0.008), palette.dark)


def car(
    build: Builder, palette: Palette, colour: Paint, place: Place, body: int | None = None
) -> None:
    """A car on z = 0 at `place`, facing x."""
    add = _Adder(build, place, body)
    long, wide = CAR_LENGTH_M, CAR_WIDTH_M
    _shadow(add, palette, long, wide)
    add.box((0, 0, 0.55), (long - 0.3, wide, 0.56), colour.side)
    add.box((0, 0, 0.82), (long - 0.34, wide - 0.04, 0.05), colour.roof)
    add.box((long / 2 - 0.14, 0, 0.5), (0.28, wide - 0.1, 0.5), colour.front)
    add.box((0.14 - long / 2, 0, 0.56), (0.28, wide - 0.1, 0.6), colour.rear)
    add.round((1.15, 0, 0.78), (2.1, wide - 0.06, 0.42), colour.roof)  # bonnet
    add.round((-1.45, 0, 0.8), (1.4, wide - 0.06, 0.5), colour.roof)  # boot
    add.round((-0.25, 0, 0.86), (3.2, wide - 0.18, 1.16), palette.glass)
    add.round((-0.35, 0, 1.34), (1.9, wide - 0.42, 0.24), colour.roof)
    for x, thick, scale in ((-0.4, 0.1, 1.0), (-1.2, 0.22, 0.84)):  # pillars, as hoops
        hoop = (thick, scale * (wide - 0.15), scale * 1.2)
        add.round((x, 0, 0.86), hoop, colour.roof)
    add.box((0, 0, 0.27), (long - 0.5, wide - 0.16, 0.12), palette.dark)
    for x in (-1.3, 1.3):
        _axle(add, palette, x, wide)
    _details(add, palette, colour, long, wide, 0.66)
    for y in (-wide / 2 - 0.06, wide / 2 + 0.06):
        add.round((0.75, y, 0.92), (0.14, 0.2, 0.14), colour.roof)


def van(
    build: Builder, palette: Palette, colour: Paint, place: Place, body: int | None = None
) -> None:
    """A delivery van on z = 0 at `place`, facing x."""
    add = _Adder(build, place, body)
    long, wide = VAN_LENGTH_M, VAN_WIDTH_M
    _shadow(add, palette, long, wide)
    add.box((-0.55, 0, 1.22), (long - 1.1, wide, 1.86), colour.van_side)
    add.box((-0.55, 0, 2.14), (long - 1.14, wide - 0.04, 0.06), colour.roof)
    add.box((long / 2 - 0.6, 0, 0.72), (1.2, wide - 0.06, 0.86), colour.front)
    add.round((1.5, 0, 1.2), (1.9, wide - 0.1, 1.7), palette.glass)
    add.round((1.0, 0, 1.95), (1.4, wide - 0.16, 0.4), colour.roof)
    add.box((0.04 - long / 2, 0, 1.55), (0.12, wide - 0.3, 0.62), palette.glass)
    print_ = int(build.rng.choice(palette.shop_signs))
    add.box((-0.9, 0, 1.45), (2.4, wide + 0.02, 0.5), print_)
    add.box((-0.1, 0, 0.26), (long - 0.4, wide - 0.16, 0.14), palette.dark)
    for x in (-1.6, 1.7):
        _axle(add, palette, x, wide)
    _details(add, palette, colour, long, wide, 0.7)


@dataclass(frozen=True, eq=False)
class _Adder:
    build: Builder
    place: Place
    body: int | None

    def box(
        self, at: tuple[float, float, float], size: tuple[float, float, float], texture: int
    ) -> None:
        """A box whose texture is fitted to its faces."""
        self._add(at, size, texture, Kind.BOX)

    def round(
        self, at: tuple[float, float, float], size: tuple[float, float, float], texture: int
    ) -> None:
        """An ellipsoid."""
        self._add(at, size, texture, Kind.ELLIPSOID)

    def _add(
        self,
        at: tuple[float, float, float],
        size: tuple[float, float, float],
        texture: int,
        kind: Kind,
    ) -> None:
        yaw = self.place.yaw
        self.build.add(self.place.at(*at), size, texture, yaw, None, kind, body=self.body)


def _axle(add: _Adder, palette: Palette, x: float, wide: float) -> None:
    for side in (-1.0, 1.0):
        y = side * (wide / 2 - 0.11)
        add.round((x, y, _WHEEL_M / 2), (_WHEEL_M, 0.3, _WHEEL_M), palette.dark)
        add.round((x, y + side * 0.1, _WHEEL_M / 2), (0.38, 0.13, 0.38), palette.metal)


def _details(
    add: _Adder, palette: Palette, colour: Paint, long: float, wide: float, height: float
) -> None:
    """Lights and number plates."""
    for end, light in ((1.0, palette.white), (-1.0, palette.metal)):
        for y in (0.32 - wide / 2, wide / 2 - 0.32):
            add.round((end * (long / 2 - 0.03), y, height + 0.04), (0.16, 0.36, 0.18), light)
        add.box((end * long / 2, 0, height - 0.24), (0.04, 0.52, 0.12), colour.plate)


def _lacquer(shade: float, rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Varnish with a faint reflection of the sky."""
    fall = np.linspace(1.35, 0.8, shape[0], dtype=np.float32)[:, None]
    return clipped(np.asarray(shade * fall + 0.015 * noise(rng, shape, 1.6), dtype=np.float32))


def _side(shade: float, box: _SideBox, rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Doors with their gaps and handles, dark sills and wheel arches."""
    image = _lacquer(shade, rng, shape)
    height, width = shape
    gap = max(0.03, 0.35 * shade)
    for u in (0.33, 0.55, 0.76):
        image[: int(0.85 * height), int(u * width)] = gap
        handle = slice(int(u * width) - 16, int(u * width) - 5)
        image[height // 4 : height // 4 + 3, handle] = min(0.9, 0.5 + shade)
    image[int((1.0 - 0.08 / box.height) * height) :] = gap
    image[height // 2] += 0.12 * (1 - shade)
    axes = (int(_ARCH_M / box.length * width), int(_ARCH_M / box.height * height))
    for x in box.wheels:
        u = (x / box.length + 0.5) * width
        v = (1.0 - (_WHEEL_M / 2 - box.foot) / box.height) * height
        cv2.ellipse(image, (int(u), int(v)), axes, 0, 0, 360, 0.05, -1, cv2.LINE_AA)
    return image


def _nose(shade: float, front: bool, rng: Rng, shape: tuple[int, int]) -> Floats32:
    """Bumper and grille, or bumper and tailgate."""
    image = _lacquer(shade, rng, shape)
    height, width = shape
    image[int(0.45 * height) : int(0.48 * height)] = 0.05
    if front:
        grille = image[height // 5 : 2 * height // 5, width // 4 : 3 * width // 4]
        grille[:] = 0.08
        grille[::5] = 0.35
    image[int(0.8 * height) :] = 0.07
    return image


def _plate(rng: Rng, shape: tuple[int, int]) -> Floats32:
    image = np.full(shape, 0.85, np.float32)
    letters = "".join(chr(int(c)) for c in rng.integers(65, 91, 4))
    title(image, f"{letters} {rng.integers(100, 999)}", 0.05)
    return image
