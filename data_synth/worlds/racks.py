"""Pallet racks and goods on pallets.

In the frame of a rack, x is along it, its back is at y = 0 and its front towards -y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from data_synth.scene.builder import Builder, Place, Point
from data_synth.scene.solids import Kind
from data_synth.worlds import indoor_textures, prints, textures

BAY_M, DEPTH_M = 2.7, 1.1
LEVELS_M = (0.0, 1.6, 3.2)
_HEIGHT_M = 4.3
_BACKED = 0.7  # fraction of bays with a back panel
_PALLET_M = (0.8, 1.16, 0.14)
_GOODS_M = 1.16  # height of the goods that fit between pallet and beam


@dataclass(frozen=True)
class Kit:
    """Numbers of the textures of racks and goods."""

    post: int
    beam: int
    grey: int
    sheet: int
    hazard: int
    pallet: int
    wood: int
    labels: tuple[int, ...]
    stacks: tuple[int, ...]
    cartons: tuple[int, ...]
    barrels: tuple[int, ...]
    sacks: tuple[int, ...]


def make_kit(build: Builder) -> Kit:
    """Paint the textures; shades differ by seed."""
    rng = build.rng
    post = partial(indoor_textures.rack_steel, shade=float(rng.uniform(0.25, 0.4)))
    beam = partial(indoor_textures.steel, shade=float(rng.uniform(0.45, 0.62)))
    return Kit(
        post=build.paint(post, (512, 128)),
        beam=build.paint(beam, (256, 512)),
        grey=build.paint(indoor_textures.steel, (256, 256)),
        sheet=build.paint(partial(indoor_textures.steel, shade=0.5), (512, 512)),
        hazard=build.paint(prints.hazard, (64, 256)),
        pallet=build.paint(prints.pallet, (64, 256)),
        wood=build.paint(textures.wood, (256, 256)),
        labels=tuple(build.paint(prints.label, (64, 128)) for _ in range(6)),
        stacks=tuple(build.paint(prints.carton_stack, (256, 256)) for _ in range(14)),
        cartons=tuple(build.paint(textures.carton, (256, 256)) for _ in range(5)),
        barrels=tuple(build.paint(prints.barrel, (256, 256)) for _ in range(4)),
        sacks=tuple(build.paint(prints.sackcloth, (256, 256)) for _ in range(4)),
    )


def rack(build: Builder, kit: Kit, place: Place, bays: int) -> None:
    """A rack of bays centred at x = 0, with its goods."""
    left = -bays * BAY_M / 2
    for bay in range(bays + 1):
        _frame(build, kit, place, left + bay * BAY_M)
    for bay in range(bays):
        middle = left + (bay + 0.5) * BAY_M
        for z in LEVELS_M[1:]:
            for y in (-0.03, 0.03 - DEPTH_M):
                size = (BAY_M - 0.1, 0.05, 0.12)
                build.add(place.at(middle, y, z - 0.06), size, kit.beam, place.yaw)
        if build.rng.random() < _BACKED:
            back = place.at(middle, -0.01, _HEIGHT_M / 2)
            size = (BAY_M - 0.1, 0.01, _HEIGHT_M - 0.2)
            build.add(back, size, kit.sheet, place.yaw, 120.0, stain=0.4)
        for level, z in enumerate(LEVELS_M):
            if level > 0:
                _labels(build, kit, place, middle, z)
            for slot in (-0.86, 0.0, 0.86):
                _slot(build, kit, place, (middle + slot, z), level)


def _frame(build: Builder, kit: Kit, place: Place, x: float) -> None:
    for y in (-0.05, 0.05 - DEPTH_M):
        build.add(place.at(x, y, _HEIGHT_M / 2), (0.09, 0.08, _HEIGHT_M), kit.post, place.yaw)
    for z in (0.25, 1.3, 2.4, 3.5):
        build.add(place.at(x, -DEPTH_M / 2, z), (0.04, DEPTH_M - 0.18, 0.05), kit.grey, place.yaw)


def _labels(build: Builder, kit: Kit, place: Place, middle: float, z: float) -> None:
    for slot in (-0.86, 0.86):
        label = int(build.rng.choice(kit.labels))
        at = place.at(middle + slot, -DEPTH_M + 0.001, z - 0.06)
        build.add(at, (0.2, 0.012, 0.1), label, place.yaw, None)


def _slot(build: Builder, kit: Kit, place: Place, at: tuple[float, float], level: int) -> None:
    """The place of one pallet, sometimes empty."""
    rng = build.rng
    if rng.random() < 0.1:
        return
    x = at[0] + float(rng.uniform(-0.015, 0.015))
    y = -DEPTH_M / 2 + float(rng.uniform(-0.03, 0.03))
    spot = Place(*place.at(x, y, 0.0)[:2], place.yaw + float(rng.uniform(-0.02, 0.02)))
    pallet(build, kit, spot, at[1], near_eye=level < 2)


def pallet(build: Builder, kit: Kit, spot: Place, z: float, near_eye: bool = True) -> None:
    """A loaded pallet, with fewer solids if it is above eye level (not near_eye)."""
    _bare_pallet(build, kit, spot, z, near_eye)
    top, rng = z + _PALLET_M[2], build.rng
    what = float(rng.random())
    if not near_eye or what < 0.45:
        size = (0.8, 1.1, float(rng.uniform(0.45, _GOODS_M)))
        stack = int(rng.choice(kit.stacks))
        build.add(spot.at(0.0, 0.0, top + size[2] / 2), size, stack, spot.yaw, None, stain=0.3)
    elif what < 0.65:
        _loose_cartons(build, kit, spot, top)
    elif what < 0.78:
        _barrels(build, kit, spot, top)
    elif what < 0.92:
        _sacks(build, kit, spot, top)
    else:
        for layer in range(int(rng.integers(2, 6))):
            _bare_pallet(build, kit, spot, top + layer * _PALLET_M[2], False)
        lid = (_PALLET_M[0], _PALLET_M[1], 0.01)
        z = top + (layer + 1) * _PALLET_M[2] + 0.005
        build.add(spot.at(0.0, 0.0, z), lid, kit.wood, spot.yaw)


def _bare_pallet(build: Builder, kit: Kit, spot: Place, z: float, near_eye: bool) -> None:
    width, deep, high = _PALLET_M
    if not near_eye:
        build.add(spot.at(0.0, 0.0, z + high / 2), _PALLET_M, kit.pallet, spot.yaw, None)
        return
    build.add(spot.at(0.0, 0.0, z + high - 0.011), (width, deep, 0.022), kit.wood, spot.yaw)
    for x in (-0.35, 0.0, 0.35):
        size = (0.1, deep - 0.02, high - 0.022)
        build.add(spot.at(x, 0.0, z + size[2] / 2), size, kit.wood, spot.yaw)


def _loose_cartons(build: Builder, kit: Kit, spot: Place, top: float) -> None:
    """Two stacks of cartons that differ in size, side by side and not quite straight."""
    for x in (-0.2, 0.2):
        z = top
        for _ in range(int(build.rng.integers(1, 4))):
            size = tuple(float(s) for s in build.rng.uniform((0.3, 0.7, 0.2), (0.38, 1.05, 0.36)))
            carton, turn = int(build.rng.choice(kit.cartons)), float(build.rng.uniform(-0.04, 0.04))
            at = spot.at(x, float(build.rng.uniform(-0.05, 0.05)), z + size[2] / 2)
            build.add(at, (size[0], size[1], size[2]), carton, spot.yaw + turn)
            z += size[2]


def _barrels(build: Builder, kit: Kit, spot: Place, top: float) -> None:
    barrel, high = int(build.rng.choice(kit.barrels)), float(build.rng.uniform(0.5, 0.85))
    for x in (-0.2, 0.2):
        for y in (-0.37, 0.02, 0.41):
            at = spot.at(x, y, top + high / 2)
            turn = float(build.rng.uniform(0, 6))
            build.add(at, (0.37, 0.37, high), barrel, turn, None, Kind.CYLINDER)


def _sacks(build: Builder, kit: Kit, spot: Place, top: float) -> None:
    sack = int(build.rng.choice(kit.sacks))
    for layer in range(int(build.rng.integers(2, 6))):
        for y in (-0.3, 0.3):
            x, turn = (float(r) for r in build.rng.uniform(-0.04, 0.04, 2))
            at: Point = spot.at(x, y, top + 0.1 + 0.12 * layer)
            build.add(at, (0.9, 0.72, 0.26), sack, spot.yaw + 2 * turn, 280.0, Kind.ELLIPSOID)
