"""Intersection of rays with the ground, a height field, and interpolation on its grid.

Grid coordinates (x to the right, y up) count cells from the corner of the height field, so that a
point lies in cell (i, j) = (floor(y), floor(x)). A cell is the bilinear patch
z(u, v) = a + b u + c v + e u v over 0 ≤ u, v ≤ 1, with a = z_ij, b = z_i,j+1 - a, c = z_i+1,j - a
and e = z_i+1,j+1 - z_i+1,j - b. Along a ray (u, v, h) + s d, the height above it is
above + slope s + bend s², a quadratic equation.
"""

from __future__ import annotations

import math

import numpy as np

from data_synth.scene.kernels.beams import beam_area
from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import FAR_M, Beam, Vector, index
from data_synth.scene.kernels.vectors import reciprocal
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


_MAX_STEPS = 6  # cells that `follow_ground` tries


@inlined
def intersect_ground(world: World, start: Vector, ray: Vector, begin: float, end: float) -> float:
    """The t between begin and end at which a ray meets the ground; infinite for a miss.

    Traverse the pyramid of peaks: skip blocks whose peak the ray stays above, descend into others,
    and solve for the hit in blocks of level 0, which are cells. A block of level k has 2^k x 2^k
    cells, so that its indices are those of its cells shifted right by k.

    Source: Tevs et al., Maximum Mipmaps for Fast, Accurate, and Scalable Dynamic Height Field
    Rendering, 2008.
    """
    height_field = world.height_field
    rows, columns = height_field.heights.shape[0] - 1, height_field.heights.shape[1] - 1
    scale = height_field.per_m
    ox, oy = (
        (start[0] - height_field.corner[0]) * scale,
        (start[1] - height_field.corner[1]) * scale,
    )
    dx, dy = scale * ray[0], scale * ray[1]
    ix, iy = reciprocal(dx), reciprocal(dy)
    # Clip the ray to the border of the grid (slab method).
    first, second = -ox * ix, (columns - ox) * ix
    near, far = max(begin, min(first, second)), min(end, max(first, second))
    first, second = -oy * iy, (rows - oy) * iy
    t, far = max(near, min(first, second)), min(far, max(first, second))
    if not t < far:
        return np.inf
    j = min(max(int(ox + t * dx), 0), columns - 1)
    i = min(max(int(oy + t * dy), 0), rows - 1)
    # Start at level 0: most rays are near the ground at `begin`, which has been advanced, or which
    # is the start of a shadow ray.
    level, top = 0, len(height_field.starts) - 1
    while True:
        # t at which the ray leaves the block across its sides in x and in y, and across any of them
        bj, bi = j >> level, i >> level
        tx = (((bj + (dx > 0.0)) << level) - ox) * ix if dx != 0.0 else np.inf
        ty = (((bi + (dy > 0.0)) << level) - oy) * iy if dy != 0.0 else np.inf
        out = max(min(tx, ty, far), t)
        peak = height_field.peaks[
            index(height_field.starts[index(level)] + bi * height_field.widths[index(level)] + bj)
        ]
        if start[2] + min(t * ray[2], out * ray[2]) <= peak:
            if level > 0:
                level -= 1
                continue
            hit = intersect_cell(world, i, j, (ox - j, oy - i, start[2]), (dx, dy, ray[2]), t, out)
            if hit < np.inf:
                return hit
        if out >= far:
            return np.inf
        # Step into the next block. The index that changes comes from integers alone; the other one
        # from the point, clamped to the block, so that rounding cannot skip a cell.
        t, oj, oi = out, j, i
        if tx < ty:
            j = (bj + 1) << level if dx > 0.0 else (bj << level) - 1
            if level > 0:
                i = min(max(int(oy + t * dy), bi << level), ((bi + 1) << level) - 1)
        else:
            i = (bi + 1) << level if dy > 0.0 else (bi << level) - 1
            if level > 0:
                j = min(max(int(ox + t * dx), bj << level), ((bj + 1) << level) - 1)
        if j < 0 or i < 0 or j >= columns or i >= rows:
            return np.inf
        # On leaving the enclosing block, too, go on at its level: longer steps for high rays.
        up = level + 1
        if level < top and (j >> up != oj >> up or i >> up != oi >> up):
            level = up


@inlined
def follow_ground(
    world: World, start: Vector, ray: Vector, between: tuple[float, float], guess: float
) -> float:
    """The t at which a descending ray meets the ground; negative if it is not found.

    The ray comes closer to the ground at all t of `between` (`ground_bounds.descent_end`), so that
    it has one hit at most. Solve the quadratic equation of the cell at the guess; if the solution
    lies in another cell, continue there, as in Newton's method.
    """
    height_field = world.height_field
    z, scale, t = height_field.heights, height_field.per_m, guess
    rows, columns = z.shape[0] - 1, z.shape[1] - 1
    ox, oy = (
        (start[0] - height_field.corner[0]) * scale,
        (start[1] - height_field.corner[1]) * scale,
    )
    dx, dy = scale * ray[0], scale * ray[1]
    for _ in range(_MAX_STEPS):
        x, y = ox + t * dx, oy + t * dy
        if not (0.0 <= x < columns and 0.0 <= y < rows):
            break
        j, i = int(x), int(y)
        z00, z01 = float(z[index(i), index(j)]), float(z[index(i), index(j + 1)])
        z10, z11 = float(z[index(i + 1), index(j)]), float(z[index(i + 1), index(j + 1)])
        a, b, c, e = z00, z01 - z00, z10 - z00, z11 - z10 - (z01 - z00)
        u, v = x - j, y - i
        above = start[2] + t * ray[2] - (a + b * u + c * v + e * u * v)
        slope = ray[2] - (b * dx + c * dy + e * (u * dy + v * dx))
        square = slope * slope + 4.0 * e * dx * dy * above
        if slope >= 0.0 or square < 0.0:
            break
        s = 2.0 * above / (math.sqrt(square) - slope)  # as in `intersect_cell`
        t, u, v = t + s, u + s * dx, v + s * dy
        if 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0:
            return t if between[0] <= t <= between[1] else -1.0
    return -1.0


@inlined
def intersect_cell(
    world: World, i: int, j: int, o: Vector, d: Vector, begin: float, end: float
) -> float:
    """The t between begin and end at which a ray meets the patch of a cell; infinite for a miss.

    `o` and `d` are origin and direction in the frame of the cell: u, v, metres.
    """
    z = world.height_field.heights
    z00, z01 = float(z[index(i), index(j)]), float(z[index(i), index(j + 1)])
    z10, z11 = float(z[index(i + 1), index(j)]), float(z[index(i + 1), index(j + 1)])
    a, b, c, e = z00, z01 - z00, z10 - z00, z11 - z10 - (z01 - z00)
    u, v = o[0] + begin * d[0], o[1] + begin * d[1]
    above = o[2] + begin * d[2] - (a + b * u + c * v + e * u * v)
    if above <= 0.0:  # below already, by rounding, at the border to the previous cell
        return begin
    slope = d[2] - (b * d[0] + c * d[1] + e * (u * d[1] + v * d[0]))
    bend = -e * d[0] * d[1]
    # The smaller positive root of above + slope s + bend s² = 0, without cancellation. A ray that
    # rises above the patch (slope > 0) meets it only if the patch curves up: bend < 0.
    square = slope * slope - 4.0 * bend * above
    if square < 0.0:
        return np.inf
    root = np.sqrt(square)
    if slope <= 0.0:
        s = 2.0 * above / (root - slope) if root - slope > 0.0 else np.inf
    else:
        s = -(slope + root) / (2.0 * bend) if bend < 0.0 else np.inf
    return begin + s if s <= end - begin else np.inf


@inlined
def ground_normal(world: World, x: float, y: float) -> Vector:
    """Normal (-dz/dx, -dz/dy, 1), not of unit length, of the patch below a point."""
    z = world.height_field.heights
    i, j, v, u = grid_position(world, x, y, 1, z)
    scale = world.height_field.per_m
    z00, z01 = z[index(i), index(j)], z[index(i), index(j + 1)]
    z10, z11 = z[index(i + 1), index(j)], z[index(i + 1), index(j + 1)]
    # Differences along the lower, the upper, the left and the right edge, then interpolated
    across, beyond, up, after = z01 - z00, z11 - z10, z10 - z00, z11 - z01
    gx, gy = scale * (across + v * (beyond - across)), scale * (up + u * (after - up))
    return -gx, -gy, 1.0


@inlined
def ground_height(world: World, x: float, y: float) -> float:
    """Height of the ground at a point."""
    heights = world.height_field.heights
    return interpolate(heights, grid_position(world, x, y, 1, heights))


@inlined
def smooth_ground_normal(world: World, x: float, y: float) -> Vector:
    """Unit normal of the ground from heights a cell away, so that cells are not visible."""
    cell = world.height_field.cell
    gx = (ground_height(world, x + cell, y) - ground_height(world, x - cell, y)) / (2.0 * cell)
    gy = (ground_height(world, x, y + cell) - ground_height(world, x, y - cell)) / (2.0 * cell)
    scale = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
    return -scale * gx, -scale * gy, scale


@inlined
def grid_position(
    world: World, x: float, y: float, finer: int, grid: Floats32
) -> tuple[int, int, float, float]:
    """Row, column and their fractions of a point on a grid `finer` times as fine as the heights."""
    height_field = world.height_field
    scale = finer * height_field.per_m
    right, up = scale * (x - height_field.corner[0]), scale * (y - height_field.corner[1])
    right = min(max(right, 0.0), grid.shape[1] - 1.0)
    up = min(max(up, 0.0), grid.shape[0] - 1.0)
    j, i = min(int(right), grid.shape[1] - 2), min(int(up), grid.shape[0] - 2)
    return i, j, up - i, right - j


@inlined
def interpolate(grid: Floats32, position: tuple[int, int, float, float]) -> float:
    """Bilinear interpolation of a grid at a position."""
    i, j, v, u = position
    z00, z01 = grid[index(i), index(j)], grid[index(i), index(j + 1)]
    z10, z11 = grid[index(i + 1), index(j)], grid[index(i + 1), index(j + 1)]
    near, far = z00 + u * (z01 - z00), z10 + u * (z11 - z10)
    return float(near + v * (far - near))
