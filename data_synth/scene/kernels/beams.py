"""Tiles of an image, the beams of their rays, and bounds of where these enter boxes.

A beam is a pair of intervals in each coordinate, of origins and of directions. Bounds by interval
arithmetic hold for every ray of it, so that a solid that a beam misses needs no test by ray.
"""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.camera import pose_at, world_ray
from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import CAST_TILE, ZERO, Beam, Rotation, Tile, Vector
from data_synth.scene.kernels.vectors import add_scaled, maximum, minimum, rotate, subtract
from data_synth.scene.shutter import Shutter
from vo.base.types import Floats


@inlined
def make_tile(rays: Floats, band: tuple[int, int], top: int, left: int, size: int) -> Tile:
    """The tile of a side `size` with this corner, cut off at the end of the band and the image."""
    return top, min(top + size, band[1]), left, min(left + size, rays.shape[1])


@inlined
def tile_beam(shutter: Shutter, rays: Floats, tile: Tile, phase: float) -> Beam:
    """The beam, in the world, of a tile enlarged by a pixel all round, at phases -phase…phase.

    ray_min > ray_max if no pixel has a ray.
    """
    low, high = (np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf)
    origin_min, origin_max = low, high
    # The first and the last row, at the start, in the middle and at the end of the exposure.
    moments = 1 if len(shutter.origins) == 1 else (6 if phase > 0.0 else 2)
    # The rays at the border of a tile enclose the others, unless the image circle ends inside.
    every, size = has_blind_corner(rays, tile), ZERO
    height, width = max(tile[1] - 1 - tile[0], 1), max(tile[3] - 1 - tile[2], 1)
    # The border of a small tile is almost straight between its corners.
    corners_only = max(height, width) < CAST_TILE and not every
    for moment in range(moments):
        row = tile[0] if moment % 2 == 0 else tile[1] - 1
        rotation, origin, _ = pose_at(shutter, rays.shape[0], row, phase * (moment // 2 - 1))
        origin_min, origin_max = minimum(origin_min, origin), maximum(origin_max, origin)
        for i in range(tile[0], tile[1], height if corners_only else 1):
            whole_row = not corners_only and (i == tile[0] or i == tile[1] - 1)
            for j in range(tile[2], tile[3], 1 if whole_row or every else width):
                if not np.isnan(rays[i, j, 0]):
                    ray = rotate(rotation, (rays[i, j, 0], rays[i, j, 1], 1.0))
                    low, high = minimum(low, ray), maximum(high, ray)
        size = maximum(size, max_pixel_step(rays, tile, rotation))
    return Beam(origin_min, origin_max, subtract(low, size), add_scaled(high, size, 1.0))


@inlined
def has_blind_corner(rays: Floats, tile: Tile) -> bool:
    """Whether a corner of a tile has no ray."""
    top, bottom, left, right = tile
    return bool(
        np.isnan(rays[top, left, 0])
        or np.isnan(rays[top, right - 1, 0])
        or np.isnan(rays[bottom - 1, left, 0])
        or np.isnan(rays[bottom - 1, right - 1, 0])
    )


@inlined
def max_pixel_step(rays: Floats, tile: Tile, rotation: Rotation) -> Vector:
    """Greatest change of the rays at the corners of a tile by one pixel."""
    step = ZERO
    for corner in range(4):
        row = tile[0] if corner < 2 else tile[1] - 1
        column = tile[2] if corner % 2 == 0 else tile[3] - 1
        if not np.isnan(rays[row, column, 0]):
            _, across, down = world_ray(rays, row, column, rotation)
            step = (
                max(step[0], abs(across[0]) + abs(down[0])),
                max(step[1], abs(across[1]) + abs(down[1])),
                max(step[2], abs(across[2]) + abs(down[2])),
            )
    return step


@inlined
def box_entry_bound(bounds: Floats, k: int, beam: Beam) -> float:
    """As `entry_bound`, for row k of bounds (N, 6): lower and upper corners of boxes."""
    return entry_bound(
        (bounds[k, 0], bounds[k, 1], bounds[k, 2]),
        (bounds[k, 3], bounds[k, 4], bounds[k, 5]),
        beam,
    )


@inlined
def entry_bound(lower: Vector, upper: Vector, beam: Beam) -> float:
    """Lower bound of the t at which rays of a beam enter a box; infinite if none can.

    The slab test in interval arithmetic: along each axis a ray is inside from
    (lower - origin) / ray to (upper - origin) / ray.
    """
    near, far = 0.0, np.inf
    for k in range(3):
        first, last = lower[k] - beam.origin_max[k], upper[k] - beam.origin_min[k]
        slow, fast = beam.ray_min[k], beam.ray_max[k]  # change with t
        if fast < 0.0:  # mirror, so that all rays go forward
            first, last, slow, fast = -last, -first, -fast, -slow
        if slow > 0.0:
            near = max(near, first / (fast if first > 0.0 else slow))
            far = min(far, last / (slow if last > 0.0 else fast))
        elif first > 0.0:  # directions of both signs: the exit has no bound
            near = max(near, first / fast if fast > 0.0 else np.inf)
        elif last < 0.0:
            near = max(near, last / slow if slow < 0.0 else np.inf)
    return near if near <= far else np.inf


@inlined
def beam_area(beam: Beam, begin: float, end: float) -> tuple[float, float, float, float]:
    """Least and greatest x, then y, of a beam between two values of t."""
    origin_min, origin_max, low, high = beam
    x0, x1 = (
        origin_min[0] + min(begin * low[0], end * low[0]),
        origin_max[0] + max(begin * high[0], end * high[0]),
    )
    y0, y1 = (
        origin_min[1] + min(begin * low[1], end * low[1]),
        origin_max[1] + max(begin * high[1], end * high[1]),
    )
    return x0, x1, y0, y1
