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
    """An upright solid, rotated about the vertical; the world is in metres with z up."""

    centre: tuple[float, float, float]
    size: tuple[float, float, float]  # its full lengths along its own x, y, z
    texture: int  # number of its texture, the same on all faces
    yaw: float = 0.0
    density: float | None = 200.0  # texels per metre; None fits the texture to each face
    # of the texture in texels, so that equal solids look different
    offset: tuple[float, float] = (0.0, 0.0)
    kind: Kind = Kind.BOX
    # strength 0…1 of the stain, a texture of low frequency that varies the brightness, so that
    # repeated textures differ from place to place and have structure from afar
    stain: float = 0.0


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground: heights on a square grid, with bilinear interpolation."""

    # (R, C) float32, metres; row r lies at y = origin_y + r * cell, column c at x = origin_x + c *
    # cell
    heights: Floats32
    origin: tuple[float, float]  # (x, y) of heights[0, 0], metres
    cell: float  # distance between grid points, metres
    texture: int  # number of its texture, projected from above
    density: float = 40.0  # texels per metre
    stain: float = 0.5


@dataclass(frozen=True)
class Lamp:
    """A square lamp that emits downward and sideways."""

    centre: tuple[float, float, float]
    power: float = 0.95  # radiance added to a surface just below
    reach_m: float = 3.5  # distance at which its light is halved
    side_m: float = 0.5


@dataclass(frozen=True)
class Lighting:
    """All light of a world."""

    lamps: tuple[Lamp, ...] = ()
    # direction towards the sun (need not be of unit length), or None indoors
    sun: tuple[float, float, float] | None = None
    sun_power: float = 0.0  # radiance added to a surface that faces the sun
    ambient: float = 0.62  # radiance of ambient light, which is weaker in corners
    # radiance of the sky at the zenith; it is paler at the horizon and has soft clouds
    sky: float = 0.8
    corner_m: float = 0.9  # distance up to which surfaces occlude each other's ambient light
    points_per_m: float = 16.0  # density of the points at which light is baked
    max_points: int = 256  # largest number of such points along a side of a face
