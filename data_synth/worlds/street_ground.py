"""Roads, pavements, kerbs, and markings and lids on them."""

from __future__ import annotations

import numpy as np

from data_synth.scene.builder import Builder, Place
from data_synth.scene.solids import Kind, Solid
from data_synth.worlds import street_plan as plan
from data_synth.worlds.palette import Palette
from data_synth.worlds.street_plan import Frontage

_DEEP_M = 0.4  # thickness of what lies on the ground
_PIECE_M = 20.0
_ASPHALT_DENSITY, _PAVING_DENSITY = 100.0, 64.0
_KERB_M = 0.16
_MARK_M = 0.006


def lay_ground(build: Builder, palette: Palette) -> None:
    """Lay grass, roads, corners and markings, without the sides of the streets."""
    size = (700.0, 700.0, _DEEP_M)
    build.add((0.0, 0.0, -0.05 - _DEEP_M / 2), size, palette.grass, 0.0, 40.0, stain=0.6)
    reach = plan.HALF_X_M + plan.ARM_M + 8.0
    for y in (-plan.HALF_Y_M, plan.HALF_Y_M):
        _road(build, palette, Place(0.0, y, 0.0), (-reach, reach))
    inside, reach = plan.HALF_Y_M - plan.BAY_M, plan.HALF_Y_M + plan.ARM_M + 8.0
    for x in (-plan.HALF_X_M, plan.HALF_X_M):
        for ends in (
            (-reach, -inside - 2 * plan.BAY_M),
            (-inside, inside),
            (inside + 2 * plan.BAY_M, reach),
        ):
            _road(build, palette, Place(x, 0.0, np.pi / 2), ends)
    for crossing in plan.crossings():
        _corners(build, palette, crossing)
        _markings(build, palette, crossing)
    _road_details(build, palette)


def lay_pavement(build: Builder, palette: Palette, side: Frontage, level: int) -> None:
    """Pavement and kerb before a line of fronts, and the gardens behind it.

    `level`: number of the pavement; overlapping ones differ by millimetres in height.
    """
    long, top = side.length + 2 * plan.PAVEMENT_M, plan.PAVED_Z_M + 0.002 * (level % 3)
    texture = palette.paving if level % 4 else palette.cobbles
    for span in _pieces((-long / 2, long / 2)):
        _strip(build, side.place, span, (-plan.PAVEMENT_M, 0.3), top, texture)
    kerb = (-plan.PAVEMENT_M - 0.02, -plan.PAVEMENT_M + _KERB_M)
    reach = side.length / 2 - 6.0  # the raised parts at both ends join the pavement
    _strip(build, side.place, (-reach, reach), kerb, top + 0.008, palette.kerb)
    garden = (0.25, plan.HOUSE_DEPTH_M + 12.0)
    _strip(build, side.place, (-side.length / 2, side.length / 2), garden, 0.1, palette.grass)


def lay_kerb_extension(
    build: Builder, palette: Palette, place: Place, span: tuple[float, float], green: bool
) -> None:
    """A raised part of the strip of parking bays, paved or with grass, with its kerb."""
    outer, inner = -plan.PAVEMENT_M - plan.BAY_M + plan.KERB_M, -plan.PAVEMENT_M - 0.01
    texture = palette.grass if green else palette.paving
    _strip(build, place, span, (outer + 0.1, inner), plan.PAVED_Z_M - 0.01, texture)
    _strip(build, place, span, (outer, outer + _KERB_M), plan.PAVED_Z_M + 0.009, palette.kerb)
    for x in span:
        end = (x - _KERB_M / 2, x + _KERB_M / 2)
        _strip(build, place, end, (outer + 0.02, inner), plan.PAVED_Z_M + 0.006, palette.kerb)


def lay_bay(build: Builder, palette: Palette, place: Place, span: tuple[float, float]) -> None:
    """Parking bays of sett stones."""
    outer, inner = -plan.PAVEMENT_M - plan.BAY_M + plan.KERB_M, -plan.PAVEMENT_M
    _strip(build, place, span, (outer, inner), 0.012, palette.cobbles)


def _road(build: Builder, palette: Palette, place: Place, ends: tuple[float, float]) -> None:
    """Asphalt along x."""
    width = (-plan.BAY_M, plan.BAY_M)
    for span in _pieces(ends):
        _strip(build, place, span, width, 0.0, palette.asphalt, _ASPHALT_DENSITY)


def _strip(
    build: Builder,
    place: Place,
    x: tuple[float, float],
    y: tuple[float, float],
    top: float,
    texture: int,
    density: float = _PAVING_DENSITY,
) -> None:
    """A slab between two x and two y of a place that is rotated by right angles.

    Its texture starts at the origin of the world, so that adjacent slabs have no seam.
    """
    corners = np.array([place.at(x[k], y[k], top) for k in (0, 1)])
    centre, size = corners.mean(axis=0), np.abs(corners[1] - corners[0])
    rows, columns = build.textures[texture].shape
    offset = (density * centre[0] % columns, -density * centre[1] % rows)
    build.solids.append(
        Solid(
            centre=(float(centre[0]), float(centre[1]), top - _DEEP_M / 2),
            size=(float(size[0]), float(size[1]), _DEEP_M),
            texture=texture,
            density=density,
            offset=(float(offset[0]), float(offset[1])),
            stain=0.45,
        )
    )


def _pieces(ends: tuple[float, float]) -> list[tuple[float, float]]:
    """Equal parts, short enough for the resolution of their baked light."""
    count = max(1, round((ends[1] - ends[0]) / _PIECE_M))
    cuts = [float(c) for c in np.linspace(*ends, count + 1)]
    return list(zip(cuts[:-1], cuts[1:], strict=True))


def _corners(build: Builder, palette: Palette, crossing: tuple[float, float]) -> None:
    """Rounded kerbs at the four corners of a crossing."""
    radius = plan.CORNER_M - plan.KERB_M
    for sx in (-1.0, 1.0):
        for sy in (-1.0, 1.0):
            x, y = crossing[0] + sx * plan.CORNER_M, crossing[1] + sy * plan.CORNER_M
            for side, top, texture in (
                (2 * radius, plan.PAVED_Z_M - 0.005, palette.kerb),
                (2 * radius - 2 * _KERB_M, plan.PAVED_Z_M + 0.007, palette.paving),
            ):
                size = (side, side, _DEEP_M)
                at = (x, y, top - _DEEP_M / 2)
                build.add(at, size, texture, 0.0, _PAVING_DENSITY, Kind.CYLINDER, 0.4)


def _markings(build: Builder, palette: Palette, crossing: tuple[float, float]) -> None:
    """Along the four streets that leave a crossing: a zebra, a stop line, a dashed middle line."""
    for quarter in range(4):
        place = Place(*crossing, quarter * np.pi / 2)
        on_loop = bool(np.dot(place.at(1, 0, 0)[:2], crossing) < np.dot(crossing, crossing))
        half = plan.HALF_X_M if quarter % 2 == 0 else plan.HALF_Y_M
        end = half if on_loop else plan.ARM_M
        if build.rng.random() < 0.6:
            _mark(build, palette.zebra, place, (10.2, 0.0), (3.0, 7.6), None)
        _mark(build, palette.marking, place, (12.6, -plan.LANE_M), (0.4, 3.6))
        for x in np.arange(15.0, end - 1.5, 6.0):
            _mark(build, palette.marking, place, (float(x) + 1.5, 0.0), (3.0, 0.14))


def _mark(
    build: Builder,
    texture: int,
    place: Place,
    at: tuple[float, float],
    size: tuple[float, float],
    density: float | None = 120.0,
) -> None:
    yaw = place.yaw
    if density is None:  # the bars of a zebra lie along the street, its texture's u across
        yaw, size = yaw + np.pi / 2, (size[1], size[0])
    build.add(place.at(*at, 0.0), (*size, 2 * _MARK_M), texture, yaw, density, stain=0.3)


def _road_details(build: Builder, palette: Palette) -> None:
    """Manholes, gullies, and patches of the road."""
    route = plan.lane(0.0, 6.0)
    ends = np.roll(route, -1, axis=0)
    for start, end in zip(route, ends, strict=True):
        length = float(np.linalg.norm(end - start))
        yaw = float(np.arctan2(*(end - start)[::-1]))
        for along in np.arange(6.0, length - 3.0, 5.5):
            along = float(along + build.rng.uniform(-2.0, 2.0))
            x, y = (float(c) for c in start + (end - start) * along / length)
            _road_detail(build, palette, Place(x, y, yaw))


def _road_detail(build: Builder, palette: Palette, place: Place) -> None:
    chance, across = build.rng.random(), float(build.rng.uniform(-3.0, 3.0))
    if chance < 0.4:
        size = (0.72, 0.72, 0.014)
        at = place.at(0, across, 0.0)
        build.add(at, size, palette.manhole, place.yaw, None, Kind.CYLINDER)
    elif chance < 0.55:
        at = place.at(0, (plan.KERB_M - 0.3) * np.sign(across), 0.0)
        build.add(at, (0.5, 0.4, 0.014), palette.manhole, place.yaw, None)
    else:
        long, wide = (float(s) for s in build.rng.uniform((1.0, 0.6), (5.0, 2.0)))
        texture = palette.tar if build.rng.random() < 0.7 else palette.kerb
        at = place.at(0, np.clip(across, wide / 2 - 3.9, 3.9 - wide / 2), 0.0)
        build.add(at, (long, wide, 0.008), texture, place.yaw, _ASPHALT_DENSITY, stain=0.3)
