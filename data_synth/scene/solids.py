"""What worlds are built of: textured solids and rolling ground, before they become arrays."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from vo.types import Floats32


class Kind(IntEnum):
    """Shape of a solid; each fills its `size`."""

    BOX = 0
    ELLIPSOID = 1
    CYLINDER = 2  # upright, with an elliptic section


@dataclass(frozen=True)
class Solid:
    """An upright solid, turned about the vertical; the world is in metres with z up.

    Attributes:
        centre: its middle.
        size: its full lengths along its own x, y, z.
        texture: number of its texture, the same on all faces.
        yaw: how far it is turned about z.
        density: texels per metre; None fits the whole texture once on each face.
        offset: texels by which the texture is shifted, so that equal solids look different.
        kind: its shape.
        stain: how much (0…1) the world's stain texture, of low frequency, darkens and brightens it,
            so that repeated textures differ from place to place and show structure from afar.
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
    """Rolling ground: heights on a square grid, bilinear between.

    Attributes:
        heights: (R, C) float32, metres; row r lies at y = origin_y + r * cell, column c at
            x = origin_x + c * cell.
        origin: (x, y) of heights[0, 0], metres.
        cell: distance between grid points, metres.
        texture: number of its texture, laid on from above.
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
    """A square lamp that shines downward and sideways.

    Attributes:
        centre: its middle.
        power: radiance that it adds to a surface just below.
        reach_m: distance at which its light has halved.
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
        sun_power: radiance that the sun adds to a surface that faces it.
        ambient: radiance of light from everywhere, less in corners.
        sky: radiance of the sky, at the zenith; it is paler at the horizon and has soft clouds.
        corner_m: how far surfaces darken each other's ambient light.
        points_per_m: density of the points at which light is baked; faces have at most
            `most_points` a side.
        most_points: see points_per_m.
    """

    lamps: tuple[Lamp, ...] = ()
    sun: tuple[float, float, float] | None = None
    sun_power: float = 0.0
    ambient: float = 0.62
    sky: float = 0.8
    corner_m: float = 0.9
    points_per_m: float = 16.0
    most_points: int = 256
