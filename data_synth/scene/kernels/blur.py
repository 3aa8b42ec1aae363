"""Motion blur of pixels that one surface fills: the mean of the sharp image along the motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from data_synth.scene.kernels.camera import load_pose, pixel_motion
from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.edges import count_index
from data_synth.scene.kernels.records import (
    FILTER_REUSE,
    NOTHING,
    SAME_DEPTH,
    Pair,
    Tile,
    View,
)
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats, Floats32, Ints

_MAX_LOST_MOTION_PX = 2.0  # that the blur may lack at the border of an image


@inlined
def blur_tile(
    world: World,
    shutter: Shutter,
    rays: Floats,
    tile: Tile,
    sweeps: Floats,
    view: View,
    counts: Ints,
    marks: NDArray[np.uint8],
    image: Floats32,
) -> bool:
    """Fill in the pixels of a tile that no edge passes; True if others remain.

    Pixels whose motion goes far beyond the border of the image are marked, and remain too.
    `sweeps` are those of the rows of the tile, stored like poses.
    """
    has_others, motion = False, (0.0, 0.0)
    for row in range(tile[0], tile[1]):
        d, e, _ = load_pose(sweeps[row - tile[0]])
        sweep = d, e
        same, first, until = NOTHING, 0.0, 0
        for column in range(tile[2], tile[3]):
            number, t = view.surface[row, column], view.depth[row, column]
            if number == NOTHING:
                image[row, column] = 0.0
            elif marks[0, row, column] == 0:
                if number != same or column >= until or abs(t - first) > SAME_DEPTH * first:
                    motion = pixel_motion(world, shutter, rays, sweep, view, row, column)
                    same, first, until = number, t, column + FILTER_REUSE
                inside = clip_motion(view.image, row, column, motion)
                if abs(motion[0] - inside[0]) + abs(motion[1] - inside[1]) > _MAX_LOST_MOTION_PX:
                    marks[0, row, column] = marks[count_index(counts, motion), row, column] = 1
                    has_others = True
                else:
                    image[row, column] = mean_along_line(view.image, row, column, inside)
            else:
                has_others = True
    return has_others


@inlined
def clip_motion(sharp: Floats32, row: int, column: int, motion: Pair) -> Pair:
    """A motion, shortened so that both of its ends lie within the image."""
    across, down = abs(motion[0]), abs(motion[1])
    max_across = 2.0 * min(column, sharp.shape[1] - 1 - column) - 3.0
    max_down = 2.0 * min(row, sharp.shape[0] - 1 - row) - 3.0
    if across <= max_across and down <= max_down:
        return motion
    ratio = max(min(max_across / max(across, 1e-9), max_down / max(down, 1e-9), 1.0), 0.0)
    return ratio * motion[0], ratio * motion[1]


@inlined
def mean_along_line(sharp: Floats32, row: int, column: int, motion: Pair) -> float:
    """Mean of the sharp image along a line, `motion` long, about the middle of a pixel.

    One sample for each pixel along the longer axis, interpolated along the other and weighted by
    the part of the pixel that the line covers. The line is symmetric about the pixel, so that
    samples k before and k after the middle have one weight and mirrored positions.
    """
    across, down = motion
    is_steep = abs(down) > abs(across)
    length = abs(down) if is_steep else abs(across)
    total = float(sharp[row, column])
    if length <= 1.0:
        return total
    slope = (across if is_steep else down) / (down if is_steep else across)
    reach = 0.5 * length
    last = int(reach + 0.5)
    for k in range(1, last + 1):
        weight = min(reach + 0.5 - k, 1.0)  # less than 1 only at the end of the line
        side = k * slope
        low = math.floor(side)
        f = side - low
        if is_steep:
            a, b = column + low, column - low
            after = (1.0 - f) * sharp[row + k, a] + f * sharp[row + k, a + 1]
            before = (1.0 - f) * sharp[row - k, b] + f * sharp[row - k, b - 1]
        else:
            a, b = row + low, row - low
            after = (1.0 - f) * sharp[a, column + k] + f * sharp[a + 1, column + k]
            before = (1.0 - f) * sharp[b, column - k] + f * sharp[b - 1, column - k]
        total += weight * (after + before)
    return total / max(length, 1.0)
