"""Height field of the ground as arrays, with a pyramid of maxima for ray casting."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data_synth.scene.solids import Ground
from vo.base.types import Floats, Floats32, Ints

STAIN_PER_TEXEL = 1.0 / 16.7  # incommensurate with textures, so that their sum does not repeat


class HeightField(NamedTuple):
    """Ground on a grid of R x C points, with bilinear interpolation."""

    heights: Floats32  # (R, C); 1 x 1 for no ground
    corner: Floats  # (2,) x and y of heights[0, 0]
    cell: float  # metres between grid points
    per_m: float  # grid points in a metre
    peaks: Floats32  # (P,) greatest heights of blocks of 1, 2, 4, … cells squared, level by level
    slopes: Floats32  # (P,) upper bounds of the slope, rise over run, in the same blocks
    starts: Ints  # (L,) start of each level
    widths: Ints  # (L,) blocks in a row of each level
    texture: int  # number of its texture
    density: float  # texels per metre
    stain: float
    stain_scale: float  # texels of the stain per metre
    light: Floats32  # on a grid over the same area
    finer: int  # factor by which the grid of light is finer

    @property
    def exists(self) -> bool:
        """Whether there is ground."""
        return self.heights.size > 1


def make_height_field(ground: Ground | None) -> HeightField:
    """The ground as arrays, without light."""
    if ground is None:
        return _no_ground()
    heights = np.ascontiguousarray(ground.heights, dtype=np.float32)
    levels = _max_pyramid(_cell_peaks(heights))
    slopes = _max_pyramid(_cell_slopes(heights, ground.cell))
    sizes = [level.size for level in levels]
    return HeightField(
        heights=heights,
        corner=np.array(ground.origin, dtype=np.float64),
        cell=float(ground.cell),
        per_m=1.0 / ground.cell,
        peaks=np.concatenate([level.ravel() for level in levels]),
        slopes=np.concatenate([level.ravel() for level in slopes]),
        starts=np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64),
        widths=np.array([level.shape[1] for level in levels], dtype=np.int64),
        texture=ground.texture,
        density=float(ground.density),
        stain=float(ground.stain),
        stain_scale=float(ground.density) * STAIN_PER_TEXEL,
        light=np.zeros_like(heights),
        finer=1,
    )


def _no_ground() -> HeightField:
    one_point = np.zeros((1, 1), np.float32)
    return HeightField(
        heights=one_point,
        corner=np.zeros(2),
        cell=1.0,
        per_m=1.0,
        peaks=one_point[0],
        slopes=one_point[0],
        starts=np.zeros(1, np.int64),
        widths=np.ones(1, np.int64),
        texture=0,
        density=1.0,
        stain=0.0,
        stain_scale=0.0,
        light=one_point,
        finer=1,
    )


def heights_at(height_field: HeightField, points: Floats) -> Floats:
    """Heights (N,) of the ground at points (N, 2 or more), bilinear; at the border outside."""
    rows, columns = height_field.heights.shape
    x = np.clip((points[:, 0] - height_field.corner[0]) / height_field.cell, 0.0, columns - 1.0)
    y = np.clip((points[:, 1] - height_field.corner[1]) / height_field.cell, 0.0, rows - 1.0)
    j = np.minimum(x.astype(np.int64), columns - 2)
    i = np.minimum(y.astype(np.int64), rows - 2)
    u, v, z = x - j, y - i, height_field.heights.astype(np.float64)
    near = (1.0 - u) * z[i, j] + u * z[i, j + 1]
    far = (1.0 - u) * z[i + 1, j] + u * z[i + 1, j + 1]
    return np.asarray((1.0 - v) * near + v * far)


def _cell_peaks(heights: Floats32) -> Floats32:
    """Maximum height of each cell."""
    rows = np.maximum(heights[:-1], heights[1:])
    return np.asarray(np.maximum(rows[:, :-1], rows[:, 1:]))


def _cell_slopes(heights: Floats32, cell: float) -> Floats32:
    """Upper bound of the slope in each cell: of a bilinear patch, from its edges."""
    z = heights.astype(np.float64)
    across, up = np.abs(np.diff(z, axis=1)), np.abs(np.diff(z, axis=0))
    steepest = np.hypot(np.maximum(across[:-1], across[1:]), np.maximum(up[:, :-1], up[:, 1:]))
    # Slightly enlarged, so that none is below its bound after rounding to float32.
    return np.asarray(steepest / cell * (1.0 + 1e-6), dtype=np.float32)


def _max_pyramid(cells: Floats32) -> list[Floats32]:
    """Pyramid of maxima: of each cell, of 2 x 2 cells, and so on up to all of them."""
    levels = [cells]
    while levels[-1].size > 1:
        last = levels[-1]
        even = np.pad(last, [(0, n % 2) for n in last.shape], mode="edge")
        pairs = np.maximum(even[::2], even[1::2])
        levels.append(np.maximum(pairs[:, ::2], pairs[:, 1::2]))
    return levels
