"""Second pass: mark the pixels over which an edge between surfaces passes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from data_synth.scene.kernels.camera import exposure_sweep, pixel_motion
from data_synth.scene.kernels.decorators import entry_point, inlined
from data_synth.scene.kernels.frames import ground_number
from data_synth.scene.kernels.records import Pair, View, index
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats, Ints

_MIN_JUMP = 0.01  # of depth on the ground, relative; less is no edge
_JUMP = 3.0  # change of inverse depth from pixel to pixel, relative to the changes on both sides
_MAX_STEPS = 256  # along half a motion


@entry_point
def mark_edges(
    world: World,
    shutter: Shutter,
    rays: Floats,
    band: tuple[int, int],
    view: View,
    counts: Ints,
    marks: NDArray[np.uint8],
) -> None:
    """Mark the pixels over which an edge passes during the exposure, for rows of a band.

    `world`: with everything that moves in place. `rays`: (H, W, 3) of the pixels in the camera's
    frame. `band`: the edges are those of rows band[0]…band[1] - 1 to the right and below; the
    pixels that they pass may lie in other rows. `counts`: (C,) numbers of rays, see `count_index`.
    `marks`: (C, H, W) zeros; marks[0] is set to 1 for every such pixel, and marks[k] if the edge
    moves so far that the pixel needs counts[k] rays.
    """
    depth, surface = view.depth, view.surface
    rows, columns = surface.shape
    ground = ground_number(world)
    for row in range(band[0], band[1]):
        sweep, next_sweep = exposure_sweep(shutter, row), exposure_sweep(shutter, row + 1)
        lower = min(row + 1, rows - 1)
        for column in range(columns):
            right = min(column + 1, columns - 1)
            here = surface[index(row), index(column)]
            # Most pixels see the same surface as their neighbours, at nearly the same depth.
            if (
                here == surface[index(row), index(right)]
                and here == surface[index(lower), index(column)]
            ):
                if here != ground:
                    continue
                near = depth[index(row), index(column)]
                jump = max(
                    abs(near - depth[index(row), index(right)]),
                    abs(near - depth[index(lower), index(column)]),
                )
                if jump <= _MIN_JUMP * near:
                    continue
            for side in range(2):
                i, j = row + side, column + 1 - side
                if i >= rows or j >= columns:
                    continue
                if not is_edge(world, view, row, column, i, j):
                    continue
                # An edge belongs to the nearer surface and moves with it.
                if depth[row, column] <= depth[i, j]:
                    motion = pixel_motion(world, shutter, rays, sweep, view, row, column)
                else:
                    side_sweep = next_sweep if side == 1 else sweep
                    motion = pixel_motion(world, shutter, rays, side_sweep, view, i, j)
                mark_swept(counts, marks, row, column, motion)
                mark_swept(counts, marks, i, j, motion)


@inlined
def is_edge(world: World, view: View, row: int, column: int, i: int, j: int) -> bool:
    """Whether there is an edge between a pixel and pixel (i, j), the next one below or right."""
    depth, surface = view.depth, view.surface
    here = surface[row, column]
    if here != surface[i, j]:
        return True
    if here != ground_number(world):
        return False
    # Along one slope, inverse depth changes evenly; where a hill occludes another, it jumps.
    first, second = depth[row, column], depth[i, j]
    if abs(first - second) <= _MIN_JUMP * max(first, second):
        return False
    ib, jb, ia, ja = 2 * row - i, 2 * column - j, 2 * i - row, 2 * j - column
    if min(ib, jb) < 0 or ia >= surface.shape[0] or ja >= surface.shape[1]:
        return False
    if surface[ib, jb] != here or surface[ia, ja] != here:
        return False
    w, v = 1.0 / first, 1.0 / second
    around = max(abs(1.0 / depth[ib, jb] - w), abs(1.0 / depth[ia, ja] - v))
    return bool(abs(w - v) > _JUMP * around)


@inlined
def mark_swept(counts: Ints, marks: NDArray[np.uint8], row: int, column: int, motion: Pair) -> None:
    """Mark the pixels over which a point moves that is in the middle of one at mid-exposure."""
    _, rows, columns = marks.shape
    level = count_index(counts, motion)
    marks[0, row, column] = marks[level, row, column] = 1
    steps = min(int(max(abs(motion[0]), abs(motion[1]))) + 1, _MAX_STEPS)
    for k in range(-steps, steps + 1):
        phase = 0.5 * k / steps
        i, j = (
            int(np.floor(row + phase * motion[1] + 0.5)),
            int(np.floor(column + phase * motion[0] + 0.5)),
        )
        if 0 <= i < rows and 0 <= j < columns:
            marks[0, i, j] = marks[level, i, j] = 1


@inlined
def count_index(counts: Ints, motion: Pair) -> int:
    """Index of the smallest number of rays for a motion: at least 4, plus 1.2 for each pixel."""
    level, min_rays = 0, 4.0 + 1.2 * math.sqrt(motion[0] * motion[0] + motion[1] * motion[1])
    while level + 1 < len(counts) and counts[level] < min_rays:
        level += 1
    return level
