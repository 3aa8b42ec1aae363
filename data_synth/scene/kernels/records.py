"""Types and constants that the kernels share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_synth.scene.solids import Kind
from vo.base.types import Floats, Floats32, Ints

BAND_ROWS = 32  # rows of an image that a thread renders at a time
CULL_TILE, CAST_TILE = 32, 8  # sides, in pixels, of tiles with a list of candidates of their own
LANES = 8  # rays of a packet

BOX, ELLIPSOID = int(Kind.BOX), int(Kind.ELLIPSOID)
ROUND, SIDE = 3, 4  # parts of solids: an ellipsoid, a cylinder's side; 0, 1, 2 are flat, by axis
SKY, NOTHING = -1, -2  # surface numbers
GROUND = 1 << 40  # in place of the number of a solid
# Marks of pixels: an edge passes; rays may hit a surface that no neighbour hits.
EDGE, UNCERTAIN = 1, 2

FAR_M = 1000.0  # nothing but the sky is farther away
FILTER_REUSE = 4  # pixels of a row that share a texture filter and their motion,
SAME_DEPTH = 0.01  # as long as their depths differ by no more than this fraction

FRACTION_BITS = 16  # of texture coordinates in fixed point
ONE_TEXEL = float(1 << FRACTION_BITS)

# For indices that are not negative: signed ones cost a few instructions each, because Python's
# negative ones count from the end.
index = np.uint64

Vector = tuple[float, float, float]
Pair = tuple[float, float]
Rotation = tuple[Vector, Vector, Vector]  # rows
Pose = tuple[Rotation, Vector, float]  # world_from_cam: rotation, origin; seconds since the stamp
Sweep = tuple[Rotation, Vector]  # see `motion.exposure_sweep`
Tile = tuple[int, int, int, int]  # first row, last row + 1, first column, last column + 1
SlabHit = tuple[float, float, float]  # t at the entrance and at the exit, face of the entrance
SolidList = tuple[Ints, Floats]  # room for solids and, for each, the t before which no ray meets it

ZERO = (0.0, 0.0, 0.0)


class View(NamedTuple):
    """Hits of the centre rays of all pixels, in the middle of the exposure of their rows."""

    image: Floats32  # (H, W) radiance, 0…1
    depth: Floats32  # (H, W) t of the hit, which is its depth
    surface: NDArray[np.int32]  # (H, W) number of the surface


class Sampling(NamedTuple):
    """Rays of the pixels that edges pass."""

    counts: Ints  # (C,) rays of a pixel, more of them for more motion
    offsets: Floats  # (C, max(counts), 3) offset of each across, down and in time, -0.5…0.5


class Shape(NamedTuple):
    """A row of `World.shapes` as scalars, which stay in registers while arrays are written."""

    x: float
    y: float
    z: float
    half_x: float
    half_y: float
    half_z: float
    cosine: float
    sine: float
    inverse_x: float
    inverse_y: float
    inverse_z: float


class Beam(NamedTuple):
    """Intervals that contain the origins and the directions of a group of rays."""

    origin_min: Vector
    origin_max: Vector
    ray_min: Vector
    ray_max: Vector


class Candidates(NamedTuple):
    """Solids and ground that a group of rays may meet."""

    solids: Ints  # (K,) by `entries`, in ascending order
    entries: Floats  # (K,) t before which no ray meets the solid
    ground_entry: float  # t before which no ray meets the ground, infinite for none
    descent_end: float  # see `ground_bounds.descent_end`


class Filter(NamedTuple):
    """Parameters of the mean of a texture over the footprint of a ray."""

    level: int
    samples: int  # number of samples along the longer side of the footprint
    next_weight: float  # weight of the next level, 0…1
    scale: float  # fixed-point units of the level in a texel of level 0
    right: float  # the longer side, in texels of level 0, to the right
    down: float
    stain_level: int  # mip-map level of the stain, which one sample of one level approximates
    stain_scale: float  # texels of that level in a texel of level 0
