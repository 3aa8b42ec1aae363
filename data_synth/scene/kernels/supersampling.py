"""Mean radiance of pixels that edges pass: many rays, one texture look-up for each surface."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_synth.scene.kernels.camera import load_pose, pixel_ray, pose_at, surface_motion
from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.frames import ground_number
from data_synth.scene.kernels.ground import follow_ground, intersect_ground
from data_synth.scene.kernels.packets import intersect_solids, nearest_hit, set_ray
from data_synth.scene.kernels.records import (
    EDGE,
    LANES,
    NOTHING,
    SKY,
    UNCERTAIN,
    Candidates,
    Pair,
    Sampling,
    Sweep,
    Tile,
    Vector,
    View,
)
from data_synth.scene.kernels.shading import choose_filter, surface_radiance
from data_synth.scene.kernels.vectors import rotate, rotate_xy
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats, Floats32, Ints

_MAX_NEIGHBOURS = 4  # solids in the 3 x 3 pixels; with more, an unseen one may lie between them


class Scratch(NamedTuple):
    """Memory that is reused for every pixel of a band."""

    # (G, 5) for each surface, of the rays that meet it: their number, the sums of their offsets
    # across, down and in time, the sum of 1 / t
    groups: Floats
    numbers: Ints  # (G,) surfaces of the groups
    packet: Floats  # rays, see `packets`
    around: Ints  # (9,) solids that neighbouring pixels see
    entries: Floats  # (9,) zeros


@inlined
def supersample_tile(
    world: World,
    shutter: Shutter,
    rays: Floats,
    tile: Tile,
    stage: int,
    candidates: Candidates,
    sampling: Sampling,
    poses: Floats,
    sweeps: Floats,
    scratch: Scratch,
    view: View,
    marks: NDArray[np.uint8],
    image: Floats32,
) -> bool:
    """Fill in the pixels of a tile whose mark is `stage`; False if some need the next stage.

    Stage EDGE: where little moves, the candidates are the surfaces that the centre rays of the
    3 x 3 pixels met, so that no culling is needed. A pixel becomes UNCERTAIN if that fails: a ray
    meets nothing although no neighbour sees the sky, or more than _MAX_NEIGHBOURS solids are near.
    Stage UNCERTAIN: the candidates are those of the tile.
    """
    counts, offsets = sampling
    is_done = True
    for row in range(tile[0], tile[1]):
        d, e, _ = load_pose(sweeps[row - tile[0]])
        for column in range(tile[2], tile[3]):
            if marks[0, row, column] != stage or view.surface[row, column] == NOTHING:
                continue
            # Edges of different motion may pass one pixel: the greatest number of rays counts.
            level = len(counts) - 1
            while level > 0 and marks[level, row, column] == 0:
                level -= 1
            likely, is_open, is_clear = candidates, True, True
            if stage == EDGE:
                count, entry, sees_sky = neighbouring_solids(
                    world, view, row, column, scratch.around
                )
                likely = Candidates(scratch.around[:count], scratch.entries[:count], entry, 0.0)
                is_open = sees_sky
                is_clear = level == 0 and count <= _MAX_NEIGHBOURS
            mean = -1.0
            if is_clear:
                mean = supersample_pixel(
                    world,
                    shutter,
                    rays,
                    (row, column),
                    likely,
                    is_open,
                    level,
                    offsets[level, : counts[level]],
                    poses[row - tile[0]],
                    scratch,
                    (d, e),
                    view,
                )
            if mean >= 0.0 or stage == UNCERTAIN:
                image[row, column] = mean
            else:
                marks[0, row, column] = UNCERTAIN
                is_done = False
    return is_done


@inlined
def supersample_pixel(
    world: World,
    shutter: Shutter,
    rays: Floats,
    pixel: tuple[int, int],
    candidates: Candidates,
    is_open: bool,
    level: int,
    offsets: Floats,
    poses: Floats,
    scratch: Scratch,
    sweep: Sweep,
    view: View,
) -> float:
    """Mean radiance over the area and the exposure of one pixel.

    Rays are grouped by surface, because texture look-ups are most of the work. The radiance of
    each group is that of one ray, at the mean offset, with a footprint as large as the part of
    pixel and motion that the group covers; the result is the mean over groups, weighted by their
    rays. If the first half of the rays meet the surface of the centre ray, the second half is
    assumed to.

    `world`: with everything that moves in place. `rays`: (H, W, 3) of the pixels in the camera's
    frame. `candidates`: what may be met. `is_open`: whether rays may meet nothing; if it is false
    and one does, the result is -1. `level`: index of the number of rays. `offsets`: (K, 3) of the
    rays. `poses`: (counts[0], 13) at the offsets in time of level 0, which most pixels have.
    `sweep`: motion of the camera during the exposure of the row.
    """
    (row, column), (groups, numbers, packet, _, _) = pixel, scratch
    rows, total_rays = rays.shape[0], len(offsets)
    centre = view.surface[row, column]
    rotation, start, time = load_pose(poses[0])
    ray, across, down = pixel_ray(rays, row, column)
    count, left_out = 0, 0
    # Cast the rays in packets, and add each to the group of its surface.
    for k in range(len(offsets)):
        if k == max(4, len(offsets) // 2) and count == 1 and numbers[0] == centre:
            # One surface only: the first pass has its radiance, unless it has to be blurred.
            inverse = groups[0, 4] / groups[0, 0]
            u, v = surface_motion(world, shutter, rays, sweep, inverse, centre, row, column)
            if abs(u) <= 1.0 and abs(v) <= 1.0:
                return float(view.image[row, column])
            total_rays = k
            break
        lane = k % LANES
        if lane == 0:  # intersect the next LANES rays; the last packet repeats the last ray
            for other in range(LANES):
                m = min(k + other, len(offsets) - 1)
                if level == 0:  # poses of these phases are shared by the pixels of the row
                    rotation, start, time = load_pose(poses[m])
                else:
                    rotation, start, time = pose_at(shutter, rows, row, offsets[m, 2])
                offset_ray = ray_within_pixel(ray, across, down, offsets[m, 0], offsets[m, 1])
                set_ray(packet, other, start, time, rotate(rotation, offset_ray))
            intersect_solids(world, packet, candidates)
        t, number = nearest_hit(world, packet, lane, candidates, candidates.ground_entry)
        if number == SKY and not is_open:
            return -1.0
        inverse, group = 1.0 / t, 0
        while group < count and not (
            numbers[group] == number and is_same_piece(inverse, groups[group, 4] / groups[group, 0])
        ):
            group += 1
        if group == len(numbers):  # no room for another surface: leave this ray out of the mean
            left_out += 1
            continue
        if group == count:
            count += 1
            numbers[group] = number
            for m in range(5):
                groups[group, m] = 0.0
        groups[group, 0] += 1.0
        groups[group, 1] += offsets[k, 0]
        groups[group, 2] += offsets[k, 1]
        groups[group, 3] += offsets[k, 2]
        groups[group, 4] += inverse
    total_rays -= left_out
    # Shade each group once, at its mean offset and mean inverse depth.
    total = 0.0
    for group in range(count):
        size = groups[group, 0]
        u, v, phase = groups[group, 1] / size, groups[group, 2] / size, groups[group, 3] / size
        inverse = groups[group, 4] / size
        if shutter.width > 0.0:
            rotation, start, time = pose_at(shutter, rows, row, phase)
        mean_ray = rotate(rotation, ray_within_pixel(ray, across, down, u, v))
        motion = surface_motion(world, shutter, rays, sweep, inverse, numbers[group], row, column)
        first, second = motion_footprint(across, down, motion, size / total_rays)
        sides = (rotate_xy(rotation, first), rotate_xy(rotation, second))
        t = 1.0 / inverse
        if numbers[group] == ground_number(world):  # uneven: intersect again, near the mean
            exact = follow_ground(world, start, mean_ray, (0.9 * t, 1.1 * t), t)
            if exact < 0.0:
                exact = intersect_ground(world, start, mean_ray, 0.9 * t, 1.1 * t)
            t = min(exact, 1.1 * t)
        filter_ = choose_filter(world, start, time, mean_ray, sides, t, numbers[group])
        radiance = surface_radiance(world, start, time, mean_ray, t, numbers[group], filter_)
        total += size * radiance
    return total / total_rays


@inlined
def neighbouring_solids(
    world: World, view: View, row: int, column: int, solids: Ints
) -> tuple[int, float, bool]:
    """List the solids that the 3 x 3 pixels about one see.

    Returns their number, the t before which rays do not meet the ground there (infinite for no
    ground), and whether one of the pixels sees the sky.
    """
    depth, surface = view.depth, view.surface
    count, entry, sees_sky = 0, np.inf, False
    for i in range(max(row - 1, 0), min(row + 2, surface.shape[0])):
        for j in range(max(column - 1, 0), min(column + 2, surface.shape[1])):
            number = surface[i, j]
            if number < 0:
                sees_sky = True
            elif number == ground_number(world):
                entry = min(entry, 0.9 * depth[i, j])  # it may be nearer between the rays
            else:
                solid, k = number // 6, 0
                while k < count and solids[k] != solid:
                    k += 1
                if k == count:
                    solids[count] = solid
                    count += 1
    return count, entry, sees_sky


@inlined
def is_same_piece(inverse: float, mean: float) -> bool:
    """Whether two inverse depths differ by at most 5 %, as on one slope of the ground.

    Otherwise one hill occludes another, and their hits must not be averaged.
    """
    return abs(inverse - mean) <= 0.05 * mean


@inlined
def ray_within_pixel(ray: Pair, across: Pair, down: Pair, u: float, v: float) -> Vector:
    """A ray in the camera's frame at an offset (u, v) from the middle of its pixel."""
    return (
        ray[0] + u * across[0] + v * down[0],
        ray[1] + u * across[1] + v * down[1],
        1.0,
    )


@inlined
def motion_footprint(across: Pair, down: Pair, motion: Pair, fraction: float) -> tuple[Pair, Pair]:
    """Changes of the ray along and across a motion, over a fraction of pixel and exposure.

    A motion shorter than the side of that part of the pixel is not visible in the footprint.
    """
    # A part `fraction` of the pixel is a square of this side, in pixels.
    length = math.sqrt(motion[0] * motion[0] + motion[1] * motion[1])
    size = math.sqrt(fraction)
    if length * fraction <= size:
        return (size * across[0], size * across[1]), (size * down[0], size * down[1])
    # (u, v) is the motion in pixels, (p, q) the side of the square at right angles to it.
    u, v = fraction * motion[0], fraction * motion[1]
    p, q = -size * motion[1] / length, size * motion[0] / length
    return (
        (u * across[0] + v * down[0], u * across[1] + v * down[1]),
        (p * across[0] + q * down[0], p * across[1] + q * down[1]),
    )
