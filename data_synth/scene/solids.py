"""Descriptions of worlds: textured solids, ground and light."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from vo.base.types import Floats32


class Kind(IntEnum):
    """Shape of a solid, inscribed in a box of its `size`."""

    BOX = 0
    ELLIPSOID = 1
    CYLINDER = 2  # upright, with an elliptic section


@dataclass(frozen=True)
class Solid:
    """An upright solid, rotated about the vertical; the world is in metres with z up.

    Attributes:
        centre: its middle.
        size: its full lengths along its own x, y, z.
        texture: number of its texture, the same on all faces.
        yaw: rotation about z.
        density: texels per metre; None fits the texture to each face.
        offset: of the texture in texels, so that equal solids look different.
        kind: its shape.
        stain: strength 0…1 of the stain, a texture of low frequency that varies the brightness, so
            that repeated textures differ from place to place and have structure from afar.
    """

    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    texture: int
    yaw: float = 0.0
    density: float | None = 200.0
    offset: tuple[float, float] = (0.0, 0.0)
    kind: Kind = Kind.BOX
    stain: float = 0.0


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground: heights on a square grid, with bilinear interpolation.

    Attributes:
        heights: (R, C) float32, metres; row r lies at y = origin_y + r * cell, column c at
            x = origin_x + c * cell.
        origin: (x, y) of heights[0, 0], metres.
        cell: distance between grid points, metres.
        texture: number of its texture, projected from above.
        density: texels per metre.
        stain: as of a solid.
    """

    heights: Floats32
    origin: tuple[float, float]
    cell: float
    texture: int
    density: float = 40.0
    stain: float = 0.5


@dataclass(frozen=True)
class Lamp:
    """A square lamp that emits downward and sideways.

    Attributes:
        centre: its middle.
        power: radiance added to a surface just below.
        reach_m: distance at which its light is halved.
        side_m: its side.
    """

    centre: tuple[float, float, float]
    power: float = 0.95
    reach_m: float = 3.5
    side_m: float = 0.5


@dataclass(frozen=True)
class Lighting:
    """All light of a world.

    Attributes:
        lamps: lamps.
        sun: direction towards the sun (need not be of unit length), or None indoors.
        sun_power: radiance added to a surface that faces the sun.
        ambient: radiance of ambient light, which is weaker in corners.
        sky: radiance of the sky at the zenith; it is paler at the horizon and has soft clouds.
        corner_m: distance up to which surfaces occlude each other's ambient light.
        points_per_m: density of the points at which light is baked.
        max_points: largest number of such points along a side of a face.
    """

    lamps: tuple[Lamp, ...] = ()
    sun: tuple[float, float, float] | None = None
    sun_power: float = 0.0
    ambient: float = 0.62
    sky: float = 0.8
    corner_m: float = 0.9
    points_per_m: float = 16.0
    max_points: int = 256
