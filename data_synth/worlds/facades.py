"""Fronts of town houses: positions of windows and doors, and their textures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import cv2
import numpy as np

from data_synth.scene.builder import Builder, Rng
from data_synth.worlds import outdoor_textures
from data_synth.worlds.textures import clipped, noise
from vo.base.types import Floats32

Wall = Literal["render", "brick", "concrete"]
Ground = Literal["shop", "flat"]

PLINTH_M = 0.55
_GROUND_FLOOR_M = 3.7
_FLOOR_M = 3.1


@dataclass(frozen=True)
class Opening:
    """A window or door: its left edge and lower edge from the left foot of the front, metres."""

    x: float
    z: float
    width: float
    height: float


@dataclass(frozen=True)
class Facade:
    """A front of `width` x `height` metres."""

    width: float  # metres
    height: float  # metres
    wall: Wall
    shade: float  # mean reflectance of the wall, 0…1
    ground: Ground  # shop windows or the windows of flats on the ground floor
    floors: tuple[float, ...]  # heights of the upper floors, metres
    windows: tuple[Opening, ...]  # of the upper floors and flats
    shops: tuple[Opening, ...]
    door: Opening
    shutters: bool  # whether its windows have shutters at their sides


def plan_facade(rng: Rng, width: float, floors: int) -> Facade:
    """Choose the windows and the rest of a front with `floors` floors in all."""
    columns = max(2, round((width - 0.8) / rng.uniform(2.3, 3.3)))
    pitch = width / columns
    size = (float(rng.uniform(0.95, min(1.5, pitch - 1.0))), float(rng.uniform(1.3, 1.7)))
    lefts = [pitch * (k + 0.5) - size[0] / 2 for k in range(columns)]
    door_column = int(rng.integers(0, columns))
    heights = tuple(_GROUND_FLOOR_M + _FLOOR_M * k for k in range(floors - 1))
    windows = [Opening(x, z + 0.85, *size) for z in heights for x in lefts]
    ground: Ground = "shop" if rng.random() < 0.45 and floors > 1 else "flat"
    others = [x for k, x in enumerate(lefts) if k != door_column]
    shops: list[Opening] = []
    if ground == "flat":
        windows += [Opening(x, 1.25, *size) for x in others]
    else:
        middles = [x + size[0] / 2 for x in others]
        shops = [Opening(m - pitch / 2 + 0.2, 0.5, pitch - 0.4, 2.1) for m in middles]
    walls: tuple[Wall, ...] = ("render", "render", "render", "brick", "concrete")
    wall = walls[int(rng.integers(len(walls)))]
    shade = float(rng.uniform(0.5, 0.82) if wall == "render" else rng.uniform(0.36, 0.56))
    door = Opening(pitch * (door_column + 0.5) - 0.55, 0.15, 1.1, 2.3)
    top = _GROUND_FLOOR_M + _FLOOR_M * (floors - 1) + float(rng.uniform(0.3, 0.9))
    shutters = wall == "render" and size[0] < 0.42 * pitch and bool(rng.random() < 0.5)
    return Facade(
        width, top, wall, shade, ground, heights, tuple(windows), tuple(shops), door, shutters
    )


def paint_facade(build: Builder, plan: Facade, grain: Floats32) -> int:
    """Add the texture of a front, for a box of its size.

    `grain`: (1024, 1024) noise of zero mean and unit deviation, shared by all fronts.
    """
    rows = 512 if plan.height < 7.5 else 1024
    return build.paint(partial(_facade, plan, grain), (rows, 1024))


def wall_grain(rng: Rng) -> Floats32:
    """Noise for `paint_facade`."""
    shape = (1024, 1024)
    mixed = noise(rng, shape, 1.4) + 0.6 * noise(rng, shape, 0.4)
    mixed += 0.7 * noise(rng, shape, 1.2, stretch=0.1)
    return np.asarray(mixed / mixed.std(), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class _Sheet:
    """A texture to draw on in metres, from its lower left corner."""

    image: Floats32
    width: float
    height: float

    def patch(self, opening: Opening, grown_m: float = 0.0) -> Floats32:
        """The part of the texture in an opening, grown on all sides."""
        rows, columns = self.image.shape
        left = round((opening.x - grown_m) * columns / self.width)
        right = round((opening.x + opening.width + grown_m) * columns / self.width)
        top = round((self.height - opening.z - opening.height - grown_m) * rows / self.height)
        bottom = round((self.height - opening.z + grown_m) * rows / self.height)
        return self.image[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]


def _facade(plan: Facade, grain: Floats32, rng: Rng, shape: tuple[int, int]) -> Floats32:
    shift = (int(rng.integers(grain.shape[0])), int(rng.integers(grain.shape[1])))
    rolled = np.roll(grain, shift, axis=(0, 1))[: shape[0]]
    image = np.full(shape, plan.shade, np.float32) + np.float32(0.035) * rolled
    sheet = _Sheet(image, plan.width, plan.height)
    if plan.wall != "render":
        _courses(rng, sheet, brick=plan.wall == "brick")
    _trim(rng, plan, sheet)
    for opening in plan.windows:
        _dirt_streaks(rng, sheet, opening)
        _window(rng, plan, sheet, opening)
    for opening in plan.shops:
        _shop(rng, sheet, opening)
    _door(rng, sheet, plan.door)
    return clipped(image + np.float32(0.012) * rolled[::-1])


def _courses(rng: Rng, sheet: _Sheet, brick: bool) -> None:
    """Bricks, or large panels of concrete."""
    rows, columns = sheet.image.shape
    long_m, high_m = (0.25, 0.08) if brick else (2.6, 1.55)
    wide = max(4, round(long_m * columns / sheet.width))
    high = max(4, round(high_m * rows / sheet.height))
    joint = 0.13 if brick else -0.16
    for course, top in enumerate(range(0, rows, high)):
        strip = sheet.image[top : top + high]
        shades = np.repeat(rng.normal(0, 0.05 if brick else 0.02, -(-columns // wide)), wide)
        shift = (wide // 2) * (course % 2) * brick
        strip += np.roll(shades, shift)[:columns].astype(np.float32)
        strip[:1] += joint
        strip[1:, shift::wide] += joint


def _trim(rng: Rng, plan: Facade, sheet: _Sheet) -> None:
    """The plinth, and bands between the floors."""
    sheet.patch(Opening(0, 0, plan.width, PLINTH_M))[:] *= rng.uniform(0.5, 0.75)
    if plan.ground == "shop":
        sheet.patch(Opening(0, PLINTH_M, plan.width, 3.0))[:] *= rng.uniform(0.55, 1.1)
    for z in plan.floors:
        sheet.patch(Opening(0, z, plan.width, 0.14))[:] *= 0.84
    if plan.wall != "concrete" and rng.random() < 0.5:  # quoins
        for z in np.arange(PLINTH_M, plan.height, 0.7):
            for x in (0.0, plan.width - 0.35):
                sheet.patch(Opening(x, z, 0.35, 0.33))[:] *= 1.14


def _dirt_streaks(rng: Rng, sheet: _Sheet, opening: Opening) -> None:
    """Streaks of dirt below a sill."""
    length = float(rng.uniform(0.4, 1.0))
    patch = sheet.patch(Opening(opening.x, opening.z - length, opening.width, length))
    fading = np.linspace(1.0, 0.0, patch.shape[0], dtype=np.float32)[:, None]
    streaks = np.maximum(rng.normal(0.02, 0.05, patch.shape[1]), 0.0).astype(np.float32)
    patch -= fading * streaks


def _window(rng: Rng, plan: Facade, sheet: _Sheet, opening: Opening) -> None:
    sheet.patch(opening, 0.14)[:] *= 1.16 if plan.wall == "brick" else 0.88
    sheet.patch(opening, 0.02)[:] = 0.14  # the shadow of the reveal
    frame = 0.82 if rng.random() < 0.8 else 0.3
    sheet.patch(opening, -0.02)[:] = frame
    leaves = 2 if opening.width > 1.15 else 1
    wide = (opening.width - 0.16) / leaves
    upper = 0.35 * opening.height
    parts = [(0.1, upper), (upper + 0.06, opening.height - 0.1)] if rng.random() < 0.4 else None
    for k in range(leaves):
        for low, high in parts or [(0.1, opening.height - 0.1)]:
            pane = Opening(opening.x + 0.1 + k * wide, opening.z + low, wide - 0.06, high - low)
            _pane(rng, sheet.patch(pane))
    if rng.random() < 0.3:  # a blind, partly closed
        drop = float(rng.uniform(0.2, 0.9)) * opening.height
        blind = sheet.patch(
            Opening(opening.x, opening.z + opening.height - drop, opening.width, drop)
        )
        blind[:] = rng.uniform(0.45, 0.75)
        blind[::4] -= 0.12
    if plan.shutters:
        for x in (opening.x - 0.5 * opening.width - 0.06, opening.x + opening.width + 0.06):
            _shutter(sheet.patch(Opening(x, opening.z, 0.5 * opening.width, opening.height)))


def _shutter(patch: Floats32) -> None:
    patch[:] = 0.3
    patch[::6] = 0.17
    patch[1::6] = 0.38


def _pane(rng: Rng, patch: Floats32) -> None:
    """Glass: dark, with a paler reflection of the sky, and often curtains."""
    rows, columns = patch.shape
    if not patch.size:
        return
    fall = np.linspace(rng.uniform(0.1, 0.3), rng.uniform(0.06, 0.16), rows, dtype=np.float32)
    patch[:] = fall[:, None]
    if rng.random() < 0.5:  # curtains
        inner = max(1, int(columns * rng.uniform(0.2, 0.5)))
        folds = np.sin(np.arange(columns) * rng.uniform(0.6, 1.2)) * 0.05
        side = slice(0, inner) if rng.random() < 0.5 else slice(columns - inner, columns)
        patch[:, side] = rng.uniform(0.3, 0.5) + folds[side].astype(np.float32)
    if rng.random() < 0.5:  # reflection of houses
        foot = int(rng.integers(0, rows))
        reach = max(1, int(rng.integers(1, columns + 1)))
        corners = [(0, foot), (reach, 0), (columns, 0), (columns, foot // 2)]
        shade = float(patch.mean()) + float(rng.uniform(0.06, 0.2))
        whole = np.ascontiguousarray(patch)
        cv2.fillPoly(whole, [np.array(corners, np.int32)], shade)
        patch[:] = whole


def _shop(rng: Rng, sheet: _Sheet, opening: Opening) -> None:
    """A shop window with goods, placards and a frame."""
    sheet.patch(opening, 0.06)[:] = rng.uniform(0.1, 0.5)
    patch = sheet.patch(opening)
    _pane(rng, patch)
    rows, columns = patch.shape
    for _ in range(int(rng.integers(8, 18))):
        high, wide = int(rng.integers(rows // 12, rows // 3)), int(rng.integers(4, columns // 3))
        left = int(rng.integers(0, columns - wide))
        top = rows - high if rng.random() < 0.6 else int(rng.integers(0, rows - high))
        patch[top : top + high, left : left + wide] = rng.uniform(0.08, 0.6)
    for _ in range(int(rng.integers(0, 3))):
        high, wide = max(8, rows // 6), max(16, columns // 3)
        left, top = int(rng.integers(0, columns - wide)), int(rng.integers(0, rows - high))
        patch[top : top + high, left : left + wide] = outdoor_textures.shop_sign(rng, (high, wide))


def _door(rng: Rng, sheet: _Sheet, opening: Opening) -> None:
    sheet.patch(opening, 0.12)[:] *= 0.75
    shade = float(rng.uniform(0.12, 0.45))
    sheet.patch(opening)[:] = shade
    for z in (0.2, 1.0):
        panel = Opening(opening.x + 0.2, opening.z + z, opening.width - 0.4, 0.65)
        sheet.patch(panel, 0.04)[:] = 0.6 * shade
        sheet.patch(panel)[:] = 1.15 * shade
    light = Opening(opening.x + 0.2, opening.z + 1.75, opening.width - 0.4, 0.4)
    _pane(rng, sheet.patch(light))
    sheet.patch(Opening(opening.x + opening.width - 0.16, opening.z + 1.0, 0.07, 0.16))[:] = 0.8
