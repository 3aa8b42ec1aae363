"""Bounds of where the rays of a beam meet the ground."""

from __future__ import annotations

import math

import numpy as np

from data_synth.scene.kernels.beams import beam_area
from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import FAR_M, Beam
from data_synth.scene.world import World
from vo.base.types import Floats32


@inlined
def ground_entry_bound(world: World, beam: Beam, begin: float) -> float:
    """Advance t from `begin` as long as no ray of a beam can meet the ground; infinite for none.

    Steps grow with t, as the beam widens, and are halved where the beam comes close, down to 1 % of
    t plus 0.2. Their lengths are a trade-off of speed; the bound holds for any.
    """
    if world.height_field.heights.shape[0] == 1 or begin == np.inf:
        return np.inf
    if beam.ray_min[2] >= 0.0 and beam.origin_min[2] > world.height_field.peaks[-1]:
        return np.inf
    step = 0.15 * begin + 0.5
    while begin < FAR_M:
        if is_above_ground(world, beam, begin, begin + step):
            begin, step = begin + step, 1.15 * step
        elif step > 0.01 * begin + 0.2:
            step *= 0.5
        else:
            break
    return begin


@inlined
def is_above_ground(world: World, beam: Beam, begin: float, end: float) -> bool:
    """Whether all rays of a beam are above the ground between two values of t."""
    lowest = beam.origin_min[2] + min(begin * beam.ray_min[2], end * beam.ray_min[2])
    return bool(
        lowest > max_over_area(world, world.height_field.peaks, beam_area(beam, begin, end))
    )


@inlined
def descent_end(world: World, beam: Beam, begin: float) -> float:
    """The t up to which, from `begin` on, all rays of a beam come ever closer to the ground.

    They do so where their descent is steeper than the ground: -ray_z > |ray_xy| * slope. Each ray
    then meets the ground once at most. 0 if that is not proven, or where the ground ends.
    """
    if not begin < FAR_M:
        return 0.0
    height_field, (_, _, low, high) = world.height_field, beam
    end = 1.15 * begin + 0.5
    area = beam_area(beam, begin, end)
    rows, columns = height_field.heights.shape
    if (
        area[0] < height_field.corner[0]
        or area[1] > height_field.corner[0] + height_field.cell * (columns - 1)
        or area[2] < height_field.corner[1]
        or area[3] > height_field.corner[1] + height_field.cell * (rows - 1)
    ):
        return 0.0
    x, y = max(abs(low[0]), abs(high[0])), max(abs(low[1]), abs(high[1]))
    fall = math.sqrt(x * x + y * y) * max_over_area(world, height_field.slopes, area)
    return end if -high[2] > fall else 0.0


@inlined
def max_over_area(world: World, values: Floats32, area: tuple[float, float, float, float]) -> float:
    """The maximum of the ground's `peaks` or `slopes` over an area; -inf outside the ground.

    Read from the level of the pyramid at which the area is four blocks wide at most.
    """
    height_field, (x0, x1, y0, y1) = world.height_field, area
    rows, columns = height_field.heights.shape[0] - 1, height_field.heights.shape[1] - 1
    scale = height_field.per_m
    left, right = (x0 - height_field.corner[0]) * scale, (x1 - height_field.corner[0]) * scale
    top, bottom = (y0 - height_field.corner[1]) * scale, (y1 - height_field.corner[1]) * scale
    if right < 0.0 or bottom < 0.0 or left > columns or top > rows:
        return -np.inf
    j0, j1 = int(min(max(left, 0.0), columns - 1.0)), int(min(right, columns - 1.0))
    i0, i1 = int(min(max(top, 0.0), rows - 1.0)), int(min(bottom, rows - 1.0))
    level = 0
    while level + 1 < len(height_field.starts) and max(j1 - j0, i1 - i0) >> level > 2:
        level += 1
    greatest = -np.inf
    for i in range(i0 >> level, (i1 >> level) + 1):
        for j in range(j0 >> level, (j1 >> level) + 1):
            at = height_field.starts[level] + i * height_field.widths[level] + j
            greatest = max(greatest, values[at])
    return greatest
