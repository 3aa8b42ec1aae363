"""Compiled kernels: which surface a ray meets, its filtered texture, and the light on it.

All in one file, because numba's cache only notices changes in the file that holds a function, not
in those that it calls.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from data_synth.scene.atlas import LEVELS
from data_synth.scene.shutter import Shutter
from data_synth.scene.solids import Kind
from data_synth.scene.world import World
from vo.types import Floats, Floats32, Ints

BAND_ROWS = 32
_LIST_TILE, _CAST_TILE, _SMOOTH_TILE = 32, 8, 8
_MAX_ANISOTROPY = 8
_INVERSE = (0.0, *(1.0 / n for n in range(1, _MAX_ANISOTROPY + 1)))
_ONE_SAMPLE = 1.6**2  # up to this ratio of a footprint's sides, squared
_GROUPS = 5
_LOST_MOTION = 2.0  # pixels that motion blur may lack at the rim of an image
_JUMP = 3.0  # of inverse depth from pixel to pixel where one hill hides another
_LEAST_JUMP = 0.01
_FAR_M = 1000.0
_LIFT_M = 0.012  # light is measured just above marks and rugs that lie on a surface
_FEW_AROUND = 4  # solids that a pixel and those around it see
_GUESSES = 6
_FEW_CLOSE = 6  # solids that are asked one by one
_DARKEST = 0.35  # ambient light in the deepest corner

_BOX, _ELLIPSOID = int(Kind.BOX), int(Kind.ELLIPSOID)
_ROUND, _SIDE = 3, 4  # parts of solids: 0, 1, 2 are flat faces across an axis
_SKY, _NOTHING = -1, -2  # numbers of surfaces
_GROUND = 1 << 40  # stands for a solid
_CLOUDS_PER_TURN = 22.5
_BITS = 16  # of a texel's fraction in texture coordinates, which are whole numbers
_ONE_TEXEL, _FRACTION = float(1 << _BITS), (1 << _BITS) - 1
_PER_GREY = 1.0 / (255.0 * _ONE_TEXEL * _ONE_TEXEL)
_SHARED = 4  # pixels of a row that share motion and how their texture is averaged,
_SAME_LENGTH = 0.01  # while they are as far away as this share of the length
_LANES = 8  # rays that are asked at once for what they meet
_EDGE, _UNCERTAIN = 1, 2  # pixels that an edge crosses; whose rays may meet anything

_RAY, _START, _TIME = 0, 3 * _LANES, 6 * _LANES  # where each begins among eight rays,
_LENGTH, _NUMBER = 7 * _LANES, 8 * _LANES  # and what they meet
_ROOM = 9 * _LANES

_at = np.uint64  # an index that is not negative: Python's negative ones cost a few steps each

_F = TypeVar("_F", bound=Callable[..., Any])
_Vector = tuple[float, float, float]
_Pair = tuple[float, float]
_Turn = tuple[_Vector, _Vector, _Vector]  # rows of a rotation
_Sweep = tuple[_Turn, _Vector]
_Tile = tuple[int, int, int, int]  # rows from, to, columns from, to
_Level = tuple[int, float, float]  # mip-map level, its scale, share of the next level
_Shape = tuple[float, float, float, float, float, float, float, float, float, float, float]
_Cut = tuple[float, float, float]  # ray lengths at entrance and exit, face of the entrance
_Beam = tuple[_Vector, _Vector, _Vector, _Vector]  # least and greatest origins, then rays
_List = tuple[Ints, Floats]  # solids, and ray lengths below which each is not met
# Solids, ray lengths below which each and the ground are not met, and `_plunge`.
_Seen = tuple[Ints, Floats, float, float]
# Level, samples, share of the next level, scale; the longer side; level and scale of the stain.
_Filter = tuple[int, int, float, float, float, float, int, float]
_ZERO = (0.0, 0.0, 0.0)
_NO_FILTER = (0, 1, 0.0, 1.0, 0.0, 0.0, 0, 1.0)


def _entry(function: _F) -> _F:
    """Compile what Python calls; it frees the GIL, so that threads can share the work."""
    return cast(_F, numba.njit(nogil=True, cache=True, error_model="numpy")(function))


def _compiled(function: _F) -> _F:
    """Compile what kernels call: it may not make arrays.

    Counting references to the arrays of `World` at each call would take 70 % of the time. So it may
    not return arrays either: nobody would have counted them.
    """
    options: dict[str, Any] = {"error_model": "numpy", "forceinline": True, "_nrt": False}
    # Python does not call them: without the bridges to it, compiling takes half the time.
    options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast(_F, numba.njit(**options)(function))


# --- Views -----------------------------------------------------------------------------------


@_entry
def cast_rows(
    world: World,
    shutter: Shutter,
    rays: Floats,
    band: tuple[int, int],
    image: Floats32,
    depth: Floats32,
    surface: NDArray[np.int32],
) -> None:
    """One ray for each pixel of rows band[0]…band[1], in the middle of its exposure."""
    far, near, eight = _empty_list(world), _empty_list(world), np.empty(_ROOM)
    poses = np.empty((band[1] - band[0], 13))
    for row in range(band[0], band[1]):
        _store(_pose(shutter, rays.shape[0], row, 0.0), poses[row - band[0]])
    for top in range(band[0], band[1], _LIST_TILE):
        for left in range(0, rays.shape[1], _LIST_TILE):
            tile = _tile(rays, band, top, left, _LIST_TILE)
            middles = poses[tile[0] - band[0] :]
            count, earth = _list_seen(world, shutter, rays, tile, 0.0, far)
            for upper in range(tile[0], tile[1], _CAST_TILE):
                for first in range(tile[2], tile[3], _CAST_TILE):
                    part = _tile(rays, band, upper, first, _CAST_TILE)
                    fewer, below, plunge = _thin_out(
                        world, shutter, rays, part, 0.0, far, count, earth, near
                    )
                    seen = (near[0][:fewer], near[1][:fewer], below, plunge)
                    _meet_tile(
                        world, middles[upper - top :], rays, part, seen, eight, depth, surface
                    )
            # Apart from what is met: in one loop, both would take a sixth longer.
            _shade_tile(world, middles, rays, tile, image, depth, surface)


@_compiled
def _meet_tile(
    world: World,
    poses: Floats,
    rays: Floats,
    tile: _Tile,
    seen: _Seen,
    eight: Floats,
    depth: Floats32,
    surface: NDArray[np.int32],
) -> None:
    """Fill in what the pixels of a tile see, which is at most eight wide."""
    guess, ground = seen[2], _ground_number(world)
    for row in range(tile[0], tile[1]):
        turn, start, time = _stored(poses[row - tile[0]])
        for lane in range(_LANES):
            column = min(tile[2] + lane, tile[3] - 1)
            x, y = rays[row, column, 0], rays[row, column, 1]
            _set_ray(eight, lane, start, time, _turned(turn, (x, y, 1.0)))
        _meet_solids(world, eight, seen)
        for column in range(tile[2], tile[3]):
            if np.isnan(rays[row, column, 0]):
                depth[row, column], surface[row, column] = np.inf, _NOTHING
                continue
            t, number = _met(world, eight, column - tile[2], seen, guess)
            depth[row, column], surface[row, column] = t, number
            if number == ground:
                guess = t


@_compiled
def _shade_tile(
    world: World,
    poses: Floats,
    rays: Floats,
    tile: _Tile,
    image: Floats32,
    depth: Floats32,
    surface: NDArray[np.int32],
) -> None:
    filter_ = _NO_FILTER
    for row in range(tile[0], tile[1]):
        turn, start, time = _stored(poses[row - tile[0]])
        same, first, until = _NOTHING, 0.0, 0
        for column in range(tile[2], tile[3]):
            number = surface[row, column]
            if number == _NOTHING:
                image[row, column] = 0.0
                continue
            t = float(depth[row, column])
            if number == same and column < until and abs(t - first) <= _SAME_LENGTH * first:
                ray = _turned(turn, (rays[row, column, 0], rays[row, column, 1], 1.0))
            else:
                ray, across, down = _ray(rays, row, column, turn)
                filter_ = _filter(world, start, time, ray, (across, down), t, number)
                same, first, until = number, t, column + _SHARED
                if not _is_flat(world, number):
                    until = column
            image[row, column] = _shade(world, start, time, ray, t, number, filter_)


@_compiled
def _tile(rays: Floats, band: tuple[int, int], top: int, left: int, size: int) -> _Tile:
    return top, min(top + size, band[1]), left, min(left + size, rays.shape[1])


@_entry
def mark_rows(
    world: World,
    shutter: Shutter,
    rays: Floats,
    band: tuple[int, int],
    depth: Floats32,
    surface: NDArray[np.int32],
    counts: Ints,
    crossed: NDArray[np.uint8],
) -> None:
    """Set to 1 all pixels over which an edge between surfaces passes while they are exposed.

    That is in crossed[0], and in crossed[k] as well if the edge moves so far that its pixels need
    the k-th count of rays.
    """
    rows, columns = surface.shape
    ground = _ground_number(world)
    for row in range(band[0], band[1]):
        sweep, below = _sweep(shutter, row), _sweep(shutter, row + 1)
        lower = min(row + 1, rows - 1)
        for column in range(columns):
            right = min(column + 1, columns - 1)
            here = surface[_at(row), _at(column)]
            if here == surface[_at(row), _at(right)] and here == surface[_at(lower), _at(column)]:
                if here != ground:
                    continue
                near = depth[_at(row), _at(column)]
                most = max(
                    abs(near - depth[_at(row), _at(right)]),
                    abs(near - depth[_at(lower), _at(column)]),
                )
                if most <= _LEAST_JUMP * near:
                    continue
            for side in range(2):
                i, j = row + side, column + 1 - side
                if i >= rows or j >= columns:
                    continue
                if not _differ(world, depth, surface, row, column, i, j):
                    continue
                # An edge belongs to the nearer surface and moves with it.
                if depth[row, column] <= depth[i, j]:
                    motion = _motion_of(world, shutter, rays, sweep, depth, surface, row, column)
                else:
                    there = below if side == 1 else sweep
                    motion = _motion_of(world, shutter, rays, there, depth, surface, i, j)
                _cross(counts, crossed, row, column, motion)
                _cross(counts, crossed, i, j, motion)


@_entry
def smooth_rows(
    world: World,
    shutter: Shutter,
    rays: Floats,
    band: tuple[int, int],
    sharp: Floats32,
    depth: Floats32,
    surface: NDArray[np.int32],
    crossed: NDArray[np.uint8],
    counts: Ints,
    grains: Floats,
    image: Floats32,
) -> None:
    """The mean over the area and the exposure of each pixel of rows band[0]…band[1].

    Where one surface fills both, it is the mean of the sharp image along its motion; elsewhere of
    `counts` rays with offsets `grains` in area and time.
    """
    groups, numbers = np.empty((_GROUPS, 5)), np.empty(_GROUPS, np.int64)
    around, eight = (np.empty(9, np.int64), np.zeros(9)), np.empty(_ROOM)
    far, near = _empty_list(world), _empty_list(world)
    poses, sweeps = np.empty((band[1] - band[0], counts[0], 13)), np.empty((band[1] - band[0], 13))
    for row in range(band[0], band[1]):
        d, e = _sweep(shutter, row)
        _store((d, e, 0.0), sweeps[row - band[0]])
        for k in range(counts[0]):
            _store(_pose(shutter, rays.shape[0], row, grains[0, k, 2]), poses[row - band[0], k])
    for top in range(band[0], band[1], _LIST_TILE):
        for left in range(0, rays.shape[1], _LIST_TILE):
            tile = _tile(rays, band, top, left, _LIST_TILE)
            if not _mean_of_sharp(
                world,
                shutter,
                rays,
                tile,
                sweeps[top - band[0] :],
                (sharp, depth, surface),
                counts,
                crossed,
                image,
            ):
                continue
            count, earth = -1, 0.0
            for upper in range(tile[0], tile[1], _SMOOTH_TILE):
                for first in range(tile[2], tile[3], _SMOOTH_TILE):
                    part = _tile(rays, band, upper, first, _SMOOTH_TILE)
                    if not _is_open(crossed, part):
                        continue
                    seen = (near[0][:0], near[1][:0], np.inf, 0.0)
                    for asked in (_EDGE, _UNCERTAIN):
                        if asked == _UNCERTAIN:
                            if count < 0:
                                count, earth = _list_seen(world, shutter, rays, tile, 0.5, far)
                            fewer, below, plunge = _thin_out(
                                world, shutter, rays, part, 0.5, far, count, earth, near
                            )
                            seen = (near[0][:fewer], near[1][:fewer], below, plunge)
                        if _mean_of_rays(
                            world,
                            shutter,
                            rays,
                            part,
                            (asked, seen),
                            (counts, grains),
                            (poses[upper - band[0] :], sweeps[upper - band[0] :]),
                            (groups, numbers, eight),
                            around,
                            (sharp, depth, surface),
                            crossed,
                            image,
                        ):
                            break


@_compiled
def _is_open(crossed: NDArray[np.uint8], tile: _Tile) -> bool:
    for row in range(tile[0], tile[1]):
        for column in range(tile[2], tile[3]):
            if crossed[0, row, column] != 0:
                return True
    return False


@_compiled
def _mean_of_sharp(
    world: World,
    shutter: Shutter,
    rays: Floats,
    tile: _Tile,
    sweeps: Floats,
    middles: tuple[Floats32, Floats32, NDArray[np.int32]],
    counts: Ints,
    crossed: NDArray[np.uint8],
    image: Floats32,
) -> bool:
    """Fill in the pixels of a tile that one surface fills; whether there are others.

    At the rim, those count as crossed whose motion goes far beyond the image.
    """
    more, (sharp, depth, surface), motion = False, middles, (0.0, 0.0)
    for row in range(tile[0], tile[1]):
        d, e, _ = _stored(sweeps[row - tile[0]])
        sweep = d, e
        same, first, until = _NOTHING, 0.0, 0
        for column in range(tile[2], tile[3]):
            number, t = surface[row, column], depth[row, column]
            if number == _NOTHING:
                image[row, column] = 0.0
            elif crossed[0, row, column] == 0:
                if number != same or column >= until or abs(t - first) > _SAME_LENGTH * first:
                    motion = _motion_of(world, shutter, rays, sweep, depth, surface, row, column)
                    same, first, until = number, t, column + _SHARED
                within = _within_image(sharp, row, column, motion)
                if abs(motion[0] - within[0]) + abs(motion[1] - within[1]) > _LOST_MOTION:
                    crossed[0, row, column] = crossed[_needed(counts, motion), row, column] = 1
                    more = True
                else:
                    image[row, column] = _mean_along(sharp, row, column, within)
            else:
                more = True
    return more


@_compiled
def _mean_of_rays(
    world: World,
    shutter: Shutter,
    rays: Floats,
    tile: _Tile,
    pass_: tuple[int, _Seen],
    sampling: tuple[Ints, Floats],
    motion: tuple[Floats, Floats],
    scratch: tuple[Floats, Ints, Floats],
    around: _List,
    middles: tuple[Floats32, Floats32, NDArray[np.int32]],
    crossed: NDArray[np.uint8],
    image: Floats32,
) -> bool:
    """Fill in the pixels of a tile that an edge crosses; whether all are.

    Where little moves, their rays meet what those of the pixels around met, as `middles` (radiance,
    depth and surface) tell. Where they meet nothing, and where so many things are seen that others
    may hide between them, a pixel becomes uncertain. In a second pass, these ask all that the tile
    may see.
    """
    (asked, seen), (counts, grains), (_, depth, surface) = pass_, sampling, middles
    poses, sweeps = motion
    is_done = True
    for row in range(tile[0], tile[1]):
        d, e, _ = _stored(sweeps[row - tile[0]])
        for column in range(tile[2], tile[3]):
            if crossed[0, row, column] != asked or surface[row, column] == _NOTHING:
                continue
            level = len(counts) - 1
            while level > 0 and crossed[level, row, column] == 0:
                level -= 1
            likely, is_open, is_clear = seen, True, True
            if asked == _EDGE:
                count, below, open_ = _around(world, depth, surface, row, column, around[0])
                likely, is_open = (around[0][:count], around[1][:count], below, 0.0), open_
                is_clear = level == 0 and count <= _FEW_AROUND
            mean = -1.0
            if is_clear:
                mean = _mean_radiance(
                    world,
                    shutter,
                    rays,
                    (row, column),
                    (likely, is_open),
                    (level, grains[level, : counts[level]], poses[row - tile[0]]),
                    scratch,
                    (d, e),
                    middles,
                )
            if mean >= 0.0 or asked == _UNCERTAIN:
                image[row, column] = mean
            else:
                crossed[0, row, column] = _UNCERTAIN
                is_done = False
    return is_done


@_compiled
def _mean_radiance(
    world: World,
    shutter: Shutter,
    rays: Floats,
    pixel: tuple[int, int],
    before: tuple[_Seen, bool],
    sampling: tuple[int, Floats, Floats],
    scratch: tuple[Floats, Ints, Floats],
    sweep: _Sweep,
    middles: tuple[Floats32, Floats32, NDArray[np.int32]],
) -> float:
    """Mean shade over the area and the exposure of one pixel.

    Many rays find the share of each surface, then each is shaded once: where its rays are on
    average, and over as much of the pixel and of its motion as they take up. If the first half meet
    the surface that the ray in the middle met, so will the others. `before` has what may be met,
    and whether that may be nothing; if it may not but is, the result is negative. `sampling` has
    the number of the count of rays, their offsets and, of the least count, their poses.
    """
    (row, column), (groups, numbers, eight), (seen, is_open) = pixel, scratch, before
    level, grains, poses = sampling
    rows, many = rays.shape[0], len(grains)
    sharp, _, surface = middles
    middle = surface[row, column]
    turn, start, time = _stored(poses[0])
    ray, across, down = _steps(rays, row, column)
    count, left_out = 0, 0
    for k in range(len(grains)):
        if k == max(4, len(grains) // 2) and count == 1 and numbers[0] == middle:
            inverse = groups[0, 4] / groups[0, 0]
            u, v = _motion(world, shutter, rays, sweep, inverse, middle, row, column)
            if abs(u) <= 1.0 and abs(v) <= 1.0:
                return float(sharp[row, column])
            many = k
            break
        lane = k % _LANES
        if lane == 0:
            for other in range(_LANES):
                m = min(k + other, len(grains) - 1)
                if level == 0:
                    turn, start, time = _stored(poses[m])
                else:
                    turn, start, time = _pose(shutter, rows, row, grains[m, 2])
                to = _turned(turn, _within(ray, across, down, grains[m, 0], grains[m, 1]))
                _set_ray(eight, other, start, time, to)
            _meet_solids(world, eight, seen)
        t, number = _met(world, eight, lane, seen, seen[2])
        if number == _SKY and not is_open:
            return -1.0
        inverse, group = 1.0 / t, 0
        while group < count and not (
            numbers[group] == number and _is_near(inverse, groups[group, 4] / groups[group, 0])
        ):
            group += 1
        if group == len(numbers):  # so many surfaces that one ray less does not matter
            left_out += 1
            continue
        if group == count:
            count += 1
            numbers[group] = number
            for m in range(5):
                groups[group, m] = 0.0
        groups[group, 0] += 1.0
        groups[group, 1] += grains[k, 0]
        groups[group, 2] += grains[k, 1]
        groups[group, 3] += grains[k, 2]
        groups[group, 4] += inverse
    many -= left_out
    total = 0.0
    for group in range(count):
        size = groups[group, 0]
        u, v, share = groups[group, 1] / size, groups[group, 2] / size, groups[group, 3] / size
        inverse = groups[group, 4] / size
        if shutter.width > 0.0:
            turn, start, time = _pose(shutter, rows, row, share)
        to = _turned(turn, _within(ray, across, down, u, v))
        motion = _motion(world, shutter, rays, sweep, inverse, numbers[group], row, column)
        first, second = _footprint(across, down, motion, size / many)
        sides = (_turned_flat(turn, first), _turned_flat(turn, second))
        t = 1.0 / inverse
        if numbers[group] == _ground_number(world):  # it bends too much for a mean length
            exact = _ground_below(world, start, to, (0.9 * t, 1.1 * t), t)
            if exact < 0.0:
                exact = _ground_hit(world, start, to, 0.9 * t, 1.1 * t)
            t = min(exact, 1.1 * t)
        filter_ = _filter(world, start, time, to, sides, t, numbers[group])
        shade = _shade(world, start, time, to, t, numbers[group], filter_)
        total += size * shade
    return total / many


@_compiled
def _around(
    world: World,
    depth: Floats32,
    surface: NDArray[np.int32],
    row: int,
    column: int,
    solids: Ints,
) -> tuple[int, float, bool]:
    """List the solids that a pixel and those around it see.

    Returns their number, the length below which rays do not meet the ground there, infinite for no
    ground, and whether one of the pixels sees the sky.
    """
    count, below, is_open = 0, np.inf, False
    for i in range(max(row - 1, 0), min(row + 2, surface.shape[0])):
        for j in range(max(column - 1, 0), min(column + 2, surface.shape[1])):
            number = surface[i, j]
            if number < 0:
                is_open = True
            elif number == _ground_number(world):
                below = min(below, 0.9 * depth[i, j])
            else:
                solid, k = number // 6, 0
                while k < count and solids[k] != solid:
                    k += 1
                if k == count:
                    solids[count] = solid
                    count += 1
    return count, below, is_open


@_compiled
def _is_near(inverse: float, mean: float) -> bool:
    """Whether a point is of the same piece of a surface: one hill may hide another."""
    return abs(inverse - mean) <= 0.05 * mean


@_compiled
def _within(ray: _Pair, across: _Pair, down: _Pair, u: float, v: float) -> _Vector:
    """A ray of the camera's frame at an offset within its pixel."""
    return (
        ray[0] + u * across[0] + v * down[0],
        ray[1] + u * across[1] + v * down[1],
        1.0,
    )


@_compiled
def _footprint(across: _Pair, down: _Pair, motion: _Pair, share: float) -> tuple[_Pair, _Pair]:
    """Changes of the ray along and across a motion, over a share of a pixel and of its time."""
    length = math.sqrt(motion[0] * motion[0] + motion[1] * motion[1])
    size = math.sqrt(share)
    if length * share <= size:
        return (size * across[0], size * across[1]), (size * down[0], size * down[1])
    u, v = share * motion[0], share * motion[1]
    p, q = -size * motion[1] / length, size * motion[0] / length
    return (
        (u * across[0] + v * down[0], u * across[1] + v * down[1]),
        (p * across[0] + q * down[0], p * across[1] + q * down[1]),
    )


@_compiled
def _differ(
    world: World,
    depth: Floats32,
    surface: NDArray[np.int32],
    row: int,
    column: int,
    i: int,
    j: int,
) -> bool:
    """Whether there is an edge between a pixel and the next one below or to the right."""
    here = surface[row, column]
    if here != surface[i, j]:
        return True
    if here != _ground_number(world):
        return False
    # Along one slope, inverse depth changes evenly; where a hill hides another, it jumps.
    first, second = depth[row, column], depth[i, j]
    if abs(first - second) <= _LEAST_JUMP * max(first, second):
        return False
    ib, jb, ia, ja = 2 * row - i, 2 * column - j, 2 * i - row, 2 * j - column
    if min(ib, jb) < 0 or ia >= surface.shape[0] or ja >= surface.shape[1]:
        return False
    if surface[ib, jb] != here or surface[ia, ja] != here:
        return False
    w, v = 1.0 / first, 1.0 / second
    around = max(abs(1.0 / depth[ib, jb] - w), abs(1.0 / depth[ia, ja] - v))
    return bool(abs(w - v) > _JUMP * around)


@_compiled
def _cross(counts: Ints, crossed: NDArray[np.uint8], row: int, column: int, motion: _Pair) -> None:
    """Set the pixels over which a point of a pixel moves."""
    _, rows, columns = crossed.shape
    level = _needed(counts, motion)
    crossed[0, row, column] = crossed[level, row, column] = 1
    steps = min(int(max(abs(motion[0]), abs(motion[1]))) + 1, 256)
    for k in range(-steps, steps + 1):
        share = 0.5 * k / steps
        i, j = (
            int(np.floor(row + share * motion[1] + 0.5)),
            int(np.floor(column + share * motion[0] + 0.5)),
        )
        if 0 <= i < rows and 0 <= j < columns:
            crossed[0, i, j] = crossed[level, i, j] = 1


@_compiled
def _needed(counts: Ints, motion: _Pair) -> int:
    """Which count of rays finds the mean over such a motion."""
    level, least = 0, 4.0 + 1.2 * math.sqrt(motion[0] * motion[0] + motion[1] * motion[1])
    while level + 1 < len(counts) and counts[level] < least:
        level += 1
    return level


@_compiled
def _within_image(sharp: Floats32, row: int, column: int, motion: _Pair) -> _Pair:
    """A motion, shortened at the rim of the image to what lies within it on both sides."""
    across, down = abs(motion[0]), abs(motion[1])
    right = 2.0 * min(column, sharp.shape[1] - 1 - column) - 3.0
    below = 2.0 * min(row, sharp.shape[0] - 1 - row) - 3.0
    if across <= right and down <= below:
        return motion
    share = max(min(right / max(across, 1e-9), below / max(down, 1e-9), 1.0), 0.0)
    return share * motion[0], share * motion[1]


@_compiled
def _mean_along(sharp: Floats32, row: int, column: int, motion: _Pair) -> float:
    """Mean of the sharp image along a line about a pixel.

    One sample for each pixel on the longer side, with the share of it that the line covers.
    """
    across, down = motion
    steep = abs(down) > abs(across)
    length = abs(down) if steep else abs(across)
    total = float(sharp[row, column])
    if length <= 1.0:
        return total
    slope = (across if steep else down) / (down if steep else across)
    reach = 0.5 * length
    last = int(reach + 0.5)
    for k in range(1, last + 1):
        share = min(reach + 0.5 - k, 1.0)
        side = k * slope
        low = math.floor(side)
        f = side - low
        if steep:
            a, b = column + low, column - low
            after = (1.0 - f) * sharp[row + k, a] + f * sharp[row + k, a + 1]
            before = (1.0 - f) * sharp[row - k, b] + f * sharp[row - k, b - 1]
        else:
            a, b = row + low, row - low
            after = (1.0 - f) * sharp[a, column + k] + f * sharp[a + 1, column + k]
            before = (1.0 - f) * sharp[b, column - k] + f * sharp[b - 1, column - k]
        total += share * (after + before)
    return total / max(length, 1.0)


@_compiled
def _sweep(shutter: Shutter, row: int) -> _Sweep:
    """How points in the camera's frame move from when a row opens to when it closes.

    A point of depth 1/w on a ray r moves by D r + w e; D (as rows) and e are returned.
    """
    if shutter.width == 0.0:
        return (_ZERO, _ZERO, _ZERO), _ZERO
    middle, _, _ = _pose(shutter, 1, row, 0.0)
    first, from_, _ = _pose(shutter, 1, row, -0.5)
    last, to, _ = _pose(shutter, 1, row, 0.5)
    # To first order: Rm^T (P - om) with the poses of both ends for R and o, one minus the other.
    c = (_minus(last[0], first[0]), _minus(last[1], first[1]), _minus(last[2], first[2]))
    d = (
        _turned_back(middle, (c[0][0], c[1][0], c[2][0])),
        _turned_back(middle, (c[0][1], c[1][1], c[2][1])),
        _turned_back(middle, (c[0][2], c[1][2], c[2][2])),
    )
    return d, _turned_back(middle, _minus(from_, to))


@_compiled
def _motion_of(
    world: World,
    shutter: Shutter,
    rays: Floats,
    sweep: _Sweep,
    depth: Floats32,
    surface: NDArray[np.int32],
    row: int,
    column: int,
) -> _Pair:
    """How many pixels across and down what a pixel sees moves during the exposure."""
    number = surface[row, column]
    if shutter.width == 0.0 or number == _NOTHING:
        return 0.0, 0.0
    inverse = 1.0 / depth[row, column]
    return _motion(world, shutter, rays, sweep, inverse, number, row, column)


@_compiled
def _motion(
    world: World,
    shutter: Shutter,
    rays: Floats,
    sweep: _Sweep,
    inverse: float,
    number: int,
    row: int,
    column: int,
) -> _Pair:
    """How many pixels across and down a surface of inverse depth moves during the exposure."""
    if shutter.width == 0.0:
        return 0.0, 0.0
    (x, y), across, down = _steps(rays, row, column)
    d, e = sweep
    moved = _moved(_turned(d, (x, y, 1.0)), e, inverse)
    mover = number // 6 - len(world.bounds)
    if 0 <= mover < len(world.movers.bodies):
        speed = world.movers.velocities[mover]
        turn, _, _ = _pose(shutter, 1, row, 0.0)
        way = _turned_back(turn, (speed[0], speed[1], speed[2]))
        moved = _moved(moved, way, shutter.width * shutter.step_s * inverse)
    mx, my = moved[0] - x * moved[2], moved[1] - y * moved[2]
    area = across[0] * down[1] - across[1] * down[0]
    if area == 0.0:  # alone at the end of what the lens sees
        return 0.0, 0.0
    scale = 1.0 / area
    u = scale * (mx * down[1] - my * down[0])
    v = scale * (across[0] * my - across[1] * mx)
    # Rows are taken one after the other: what moves down with them seems to move faster.
    if shutter.per_row != 0.0:
        late = 1.0 / (1.0 - min(v * shutter.per_row / shutter.width, 0.5))
        u, v = late * u, late * v
    return u, v


@_compiled
def _pose(shutter: Shutter, rows: int, row: int, share: float) -> tuple[_Turn, _Vector, float]:
    """Rotation, origin and seconds since the frame's stamp, at a share -0.5…0.5 of the exposure."""
    at = shutter.first + shutter.per_row * row + share * shutter.width
    time = shutter.step_s * (shutter.per_row * (row - 0.5 * (rows - 1)) + share * shutter.width)
    last = len(shutter.origins) - 1
    at = min(max(at, 0.0), float(last))
    i = min(int(at), max(last - 1, 0))
    j, f = min(i + 1, last), at - i
    r, q, o, p = shutter.rotations[i], shutter.rotations[j], shutter.origins[i], shutter.origins[j]
    g = 1.0 - f
    return (
        (
            (g * r[0, 0] + f * q[0, 0], g * r[0, 1] + f * q[0, 1], g * r[0, 2] + f * q[0, 2]),
            (g * r[1, 0] + f * q[1, 0], g * r[1, 1] + f * q[1, 1], g * r[1, 2] + f * q[1, 2]),
            (g * r[2, 0] + f * q[2, 0], g * r[2, 1] + f * q[2, 1], g * r[2, 2] + f * q[2, 2]),
        ),
        (g * o[0] + f * p[0], g * o[1] + f * p[1], g * o[2] + f * p[2]),
        time,
    )


@_compiled
def _store(pose: tuple[_Turn, _Vector, float], into: Floats) -> None:
    turn, origin, time = pose
    for i in range(3):
        into[9 + i] = origin[i]
        for j in range(3):
            into[3 * i + j] = turn[i][j]
    into[12] = time


@_compiled
def _stored(p: Floats) -> tuple[_Turn, _Vector, float]:
    return ((p[0], p[1], p[2]), (p[3], p[4], p[5]), (p[6], p[7], p[8])), (p[9], p[10], p[11]), p[12]


@_compiled
def _ray(rays: Floats, row: int, column: int, turn: _Turn) -> tuple[_Vector, _Vector, _Vector]:
    """A pixel's ray in the world and how it changes by one pixel across and down."""
    ray, across, down = _steps(rays, row, column)
    return (
        _turned(turn, (ray[0], ray[1], 1.0)),
        _turned_flat(turn, across),
        _turned_flat(turn, down),
    )


@_compiled
def _steps(rays: Floats, row: int, column: int) -> tuple[_Pair, _Pair, _Pair]:
    """A pixel's ray (x, y, 1) and how it changes by one pixel across and down."""
    x, y = rays[row, column, 0], rays[row, column, 1]
    if column + 1 < rays.shape[1] and not np.isnan(rays[row, column + 1, 0]):
        across = (rays[row, column + 1, 0] - x, rays[row, column + 1, 1] - y)
    else:
        across = (x - rays[row, column - 1, 0], y - rays[row, column - 1, 1])
    if row + 1 < rays.shape[0] and not np.isnan(rays[row + 1, column, 0]):
        down = (rays[row + 1, column, 0] - x, rays[row + 1, column, 1] - y)
    else:
        down = (x - rays[row - 1, column, 0], y - rays[row - 1, column, 1])
    if np.isnan(across[0]):
        across = (0.0, 0.0)
    if np.isnan(down[0]):
        down = (0.0, 0.0)
    return (x, y), across, down


# --- What a tile may see ---------------------------------------------------------------------


@_entry
def _empty_list(world: World) -> _List:
    return np.empty(len(world.kinds), np.int64), np.empty(len(world.kinds))


@_compiled
def _list_seen(
    world: World, shutter: Shutter, rays: Floats, tile: _Tile, share: float, result: _List
) -> tuple[int, float]:
    """List the solids that any ray of a tile may meet, by the shortest length at which it may.

    The rays are those of the middle `share` of the exposure to either side. Also returned is the
    length below which none of them meets the ground.
    """
    beam = _beam(shutter, rays, tile, share)
    if beam[2][0] > beam[3][0]:  # nothing at all is seen
        return 0, np.inf
    tree, (solids, starts) = world.tree, result
    node, count = 0, 0
    while node < len(tree.skip):
        near = _earliest(tree.bounds, node, beam)
        if near == np.inf:
            node = tree.skip[node]
            continue
        if tree.solid[node] >= 0:
            count = _insert(solids, starts, count, tree.solid[node], near)
        node += 1
    for mover in range(len(world.movers.bodies)):
        solid = len(world.bounds) + mover
        near = _earliest_moving(world, shutter, rays.shape[0], tile, share, solid, beam)
        if near != np.inf:
            count = _insert(solids, starts, count, solid, near)
    return count, _ground_start(world, beam, 0.0)


@_compiled
def _thin_out(
    world: World,
    shutter: Shutter,
    rays: Floats,
    tile: _Tile,
    share: float,
    listed: _List,
    count: int,
    earth: float,
    result: _List,
) -> tuple[int, float, float]:
    """Of the solids listed for a larger tile, those that a smaller one may see.

    Also returned are the length below which no ray meets the ground, `earth` being that of the
    larger tile, and `_plunge`.
    """
    beam = _beam(shutter, rays, tile, share)
    if beam[2][0] > beam[3][0]:
        return 0, np.inf, 0.0
    solids, starts = result
    fewer = 0
    for k in range(count):
        solid, near = listed[0][k], listed[1][k]
        if solid < len(world.bounds):
            near = _earliest(world.bounds, solid, beam)
        if near != np.inf:
            fewer = _insert(solids, starts, fewer, solid, near)
    below = _ground_start(world, beam, earth)
    return fewer, below, _plunge(world, beam, below)


@_compiled
def _insert(solids: Ints, starts: Floats, count: int, solid: int, near: float) -> int:
    at = count
    while at > 0 and starts[at - 1] > near:
        solids[at], starts[at] = solids[at - 1], starts[at - 1]
        at -= 1
    solids[at], starts[at] = solid, near
    return count + 1


@_compiled
def _earliest_moving(
    world: World,
    shutter: Shutter,
    rows: int,
    tile: _Tile,
    share: float,
    solid: int,
    beam: _Beam,
) -> float:
    """As `_earliest`, of a moving solid wherever it is while a tile is exposed."""
    _, _, first = _pose(shutter, rows, tile[0], -share)
    _, _, last = _pose(shutter, rows, tile[1] - 1, share)
    shape, speed = world.shapes[solid], world.movers.velocities[solid - len(world.bounds)]
    cosine, sine = abs(shape[6]), abs(shape[7])
    reach = cosine * shape[3] + sine * shape[4], sine * shape[3] + cosine * shape[4], shape[5]
    way = (speed[0], speed[1], speed[2])
    # As seen by the solid the beam starts at all places that the solid comes from.
    from_ = _least(_moved(beam[0], way, -first), _moved(beam[0], way, -last))
    to = _greatest(_moved(beam[1], way, -first), _moved(beam[1], way, -last))
    centre = (shape[0], shape[1], shape[2])
    return _earliest_in(
        _minus(centre, reach), _moved(centre, reach, 1.0), (from_, to, beam[2], beam[3])
    )


@_compiled
def _beam(shutter: Shutter, rays: Floats, tile: _Tile, share: float) -> _Beam:
    """Least and greatest origins and rays of a tile in the world, a pixel wider all round."""
    low, high = (np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf)
    from_, to = low, high
    moments = 1 if len(shutter.origins) == 1 else (6 if share > 0.0 else 2)
    # The rays inside lie between those around; but not where the lens ends inside.
    whole, size = _has_hole(rays, tile), _ZERO
    height, width = max(tile[1] - 1 - tile[0], 1), max(tile[3] - 1 - tile[2], 1)
    few = max(height, width) < _CAST_TILE and not whole  # almost straight between corners
    for moment in range(moments):
        row = tile[0] if moment % 2 == 0 else tile[1] - 1
        turn, origin, _ = _pose(shutter, rays.shape[0], row, share * (moment // 2 - 1))
        from_, to = _least(from_, origin), _greatest(to, origin)
        for i in range(tile[0], tile[1], height if few else 1):
            rim = not few and (i == tile[0] or i == tile[1] - 1)
            for j in range(tile[2], tile[3], 1 if rim or whole else width):
                if not np.isnan(rays[i, j, 0]):
                    ray = _turned(turn, (rays[i, j, 0], rays[i, j, 1], 1.0))
                    low, high = _least(low, ray), _greatest(high, ray)
        size = _greatest(size, _pixel_size(rays, tile, turn))
    return from_, to, _minus(low, size), _moved(high, size, 1.0)


@_compiled
def _has_hole(rays: Floats, tile: _Tile) -> bool:
    """Whether a corner of a tile sees nothing."""
    top, bottom, left, right = tile
    return bool(
        np.isnan(rays[top, left, 0])
        or np.isnan(rays[top, right - 1, 0])
        or np.isnan(rays[bottom - 1, left, 0])
        or np.isnan(rays[bottom - 1, right - 1, 0])
    )


@_compiled
def _pixel_size(rays: Floats, tile: _Tile, turn: _Turn) -> _Vector:
    """Greatest change of the rays at the corners of a tile by one pixel."""
    most = _ZERO
    for corner in range(4):
        row = tile[0] if corner < 2 else tile[1] - 1
        column = tile[2] if corner % 2 == 0 else tile[3] - 1
        if not np.isnan(rays[row, column, 0]):
            _, across, down = _ray(rays, row, column, turn)
            most = (
                max(most[0], abs(across[0]) + abs(down[0])),
                max(most[1], abs(across[1]) + abs(down[1])),
                max(most[2], abs(across[2]) + abs(down[2])),
            )
    return most


@_compiled
def _earliest(bounds: Floats, k: int, beam: _Beam) -> float:
    """Lower bound of the length at which rays of a beam meet the box bounds[k]; or infinite."""
    return _earliest_in(
        (bounds[k, 0], bounds[k, 1], bounds[k, 2]),
        (bounds[k, 3], bounds[k, 4], bounds[k, 5]),
        beam,
    )


@_compiled
def _earliest_in(lower: _Vector, upper: _Vector, beam: _Beam) -> float:
    from_, to, low, high = beam
    near, far = 0.0, np.inf
    for k in range(3):
        first, last = lower[k] - to[k], upper[k] - from_[k]
        slow, fast = low[k], high[k]
        if fast < 0.0:  # mirrored, rays go forward
            first, last, slow, fast = -last, -first, -fast, -slow
        if slow > 0.0:
            near = max(near, first / (fast if first > 0.0 else slow))
            far = min(far, last / (slow if last > 0.0 else fast))
        elif first > 0.0:
            near = max(near, first / fast if fast > 0.0 else np.inf)
        elif last < 0.0:
            near = max(near, last / slow if slow < 0.0 else np.inf)
    return near if near <= far else np.inf


@_compiled
def _ground_start(world: World, beam: _Beam, begin: float) -> float:
    """Length from `begin` on below which no ray of a beam meets the ground; infinite for none."""
    if world.relief.heights.shape[0] == 1 or begin == np.inf:
        return np.inf
    if beam[2][2] >= 0.0 and beam[0][2] > world.relief.peaks[-1]:
        return np.inf
    step = 0.15 * begin + 0.5
    while begin < _FAR_M:
        if _above_ground(world, beam, begin, begin + step):
            begin, step = begin + step, 1.15 * step
        elif step > 0.01 * begin + 0.2:
            step *= 0.5
        else:
            break
    return begin


@_compiled
def _above_ground(world: World, beam: _Beam, begin: float, end: float) -> bool:
    """Whether all rays of a beam are above the ground between two lengths."""
    least = beam[0][2] + min(begin * beam[2][2], end * beam[2][2])
    return bool(least > _most_within(world, world.relief.peaks, _area(beam, begin, end)))


@_compiled
def _plunge(world: World, beam: _Beam, begin: float) -> float:
    """Length up to which, from `begin` on, all rays of a beam come ever closer to the ground.

    They are to meet it between; 0 where some might not come closer.
    """
    if not begin < _FAR_M:
        return 0.0
    relief, (_, _, low, high) = world.relief, beam
    end = 1.15 * begin + 0.5
    area = _area(beam, begin, end)
    rows, columns = relief.heights.shape
    if (
        area[0] < relief.corner[0]
        or area[1] > relief.corner[0] + relief.cell * (columns - 1)
        or area[2] < relief.corner[1]
        or area[3] > relief.corner[1] + relief.cell * (rows - 1)
    ):
        return 0.0
    x, y = max(abs(low[0]), abs(high[0])), max(abs(low[1]), abs(high[1]))
    fall = math.sqrt(x * x + y * y) * _most_within(world, relief.slopes, area)
    return end if -high[2] > fall else 0.0


@_compiled
def _area(beam: _Beam, begin: float, end: float) -> tuple[float, float, float, float]:
    """Least and greatest x, then y, of a beam between two lengths."""
    from_, to, low, high = beam
    x0, x1 = (
        from_[0] + min(begin * low[0], end * low[0]),
        to[0] + max(begin * high[0], end * high[0]),
    )
    y0, y1 = (
        from_[1] + min(begin * low[1], end * low[1]),
        to[1] + max(begin * high[1], end * high[1]),
    )
    return x0, x1, y0, y1


@_compiled
def _most_within(world: World, values: Floats32, area: tuple[float, float, float, float]) -> float:
    """The greatest of the ground's `peaks` or `slopes` over an area; -inf beside the ground."""
    relief, (x0, x1, y0, y1) = world.relief, area
    rows, columns = relief.heights.shape[0] - 1, relief.heights.shape[1] - 1
    scale = relief.per_m
    left, right = (x0 - relief.corner[0]) * scale, (x1 - relief.corner[0]) * scale
    top, bottom = (y0 - relief.corner[1]) * scale, (y1 - relief.corner[1]) * scale
    if right < 0.0 or bottom < 0.0 or left > columns or top > rows:
        return -np.inf
    j0, j1 = int(min(max(left, 0.0), columns - 1.0)), int(min(right, columns - 1.0))
    i0, i1 = int(min(max(top, 0.0), rows - 1.0)), int(min(bottom, rows - 1.0))
    level = 0
    while level + 1 < len(relief.starts) and max(j1 - j0, i1 - i0) >> level > 2:
        level += 1
    most = -np.inf
    for i in range(i0 >> level, (i1 >> level) + 1):
        for j in range(j0 >> level, (j1 >> level) + 1):
            at = relief.starts[level] + i * relief.widths[level] + j
            most = max(most, values[at])
    return most


# --- What one ray meets ----------------------------------------------------------------------


@_compiled
def _set_ray(eight: Floats, lane: int, start: _Vector, time: float, ray: _Vector) -> None:
    """Set one of eight rays."""
    for k in range(3):
        eight[_at(_RAY + k * _LANES + lane)] = ray[k]
        eight[_at(_START + k * _LANES + lane)] = start[k]
    eight[_at(_TIME + lane)] = time


@_compiled
def _meet_solids(world: World, eight: Floats, seen: _Seen) -> None:
    """Find ray lengths and numbers of the surfaces that eight rays meet, among the solids seen.

    Loops over the rays have no branches and no array but `eight`, so that compilers make a few
    vector instructions of them.
    """
    solids, starts, _, _ = seen
    for lane in range(_LANES):
        eight[_LENGTH + lane], eight[_NUMBER + lane] = np.inf, float(_SKY)
    for i in range(len(solids)):
        done = 0
        for lane in range(_LANES):
            done += eight[_LENGTH + lane] <= starts[i]
        if done == _LANES:
            break
        kind = world.kinds[_at(solids[i])]
        if kind == _BOX:
            _meet_box(world, eight, solids[i])
        elif kind == _ELLIPSOID:
            _meet_ellipsoid(world, eight, solids[i])
        else:
            _meet_cylinder(world, eight, solids[i])


@_compiled
def _meet_box(world: World, eight: Floats, solid: int) -> None:
    shape, speed = _shape(world, solid), _speed(world, solid)
    for lane in range(_LANES):
        o, d = _lane(eight, lane, shape, speed)
        near, far, face = _cut_box(o, d, shape)
        _keep(eight, lane, near, far, 6.0 * solid + face)


@_compiled
def _meet_ellipsoid(world: World, eight: Floats, solid: int) -> None:
    shape, speed = _shape(world, solid), _speed(world, solid)
    for lane in range(_LANES):
        o, d = _lane(eight, lane, shape, speed)
        near, far = _round_span(o, d, shape[8], shape[9], shape[10])
        _keep(eight, lane, near, far, 6.0 * solid)


@_compiled
def _meet_cylinder(world: World, eight: Floats, solid: int) -> None:
    shape, speed = _shape(world, solid), _speed(world, solid)
    for lane in range(_LANES):
        o, d = _lane(eight, lane, shape, speed)
        near, far, face = _cut_cylinder(o, d, shape)
        _keep(eight, lane, near, far, 6.0 * solid + face)


@_compiled
def _lane(eight: Floats, lane: int, shape: _Shape, speed: _Vector) -> tuple[_Vector, _Vector]:
    """Origin and direction of one of eight rays in the frame of a solid."""
    late = -eight[_TIME + lane]
    x = eight[_START + lane] + late * speed[0] - shape[0]
    y = eight[_START + _LANES + lane] + late * speed[1] - shape[1]
    z = eight[_START + 2 * _LANES + lane] + late * speed[2] - shape[2]
    u, v = eight[_RAY + lane], eight[_RAY + _LANES + lane]
    cosine, sine = shape[6], shape[7]
    return (
        (cosine * x + sine * y, cosine * y - sine * x, z),
        (cosine * u + sine * v, cosine * v - sine * u, eight[_RAY + 2 * _LANES + lane]),
    )


@_compiled
def _keep(eight: Floats, lane: int, near: float, far: float, number: float) -> None:
    """Take a surface that a ray enters at `near` if it is the nearest so far."""
    length, before = eight[_LENGTH + lane], eight[_NUMBER + lane]
    nearest = (near > 0.0) & (near <= far) & (near < length)
    eight[_LENGTH + lane] = near if nearest else length
    eight[_NUMBER + lane] = number if nearest else before


@_compiled
def _met(world: World, eight: Floats, lane: int, seen: _Seen, guess: float) -> tuple[float, int]:
    """Ray length and number of the surface that one of eight rays meets, the ground included.

    `_meet_solids` comes before; `guess` is where the ray may meet the ground.
    """
    t = eight[_at(_LENGTH + lane)]
    if seen[2] < t:
        ray = (
            eight[_at(_RAY + lane)],
            eight[_at(_RAY + _LANES + lane)],
            eight[_at(_RAY + 2 * _LANES + lane)],
        )
        start = (
            eight[_at(_START + lane)],
            eight[_at(_START + _LANES + lane)],
            eight[_at(_START + 2 * _LANES + lane)],
        )
        below = -1.0
        if seen[3] > 0.0:
            below = _ground_below(world, start, ray, (seen[2], seen[3]), guess)
        if below < 0.0:
            below = _ground_hit(world, start, ray, seen[2], t)
        if below < t:
            return below, _ground_number(world)
    return t, int(eight[_at(_NUMBER + lane)])


@_compiled
def _is_flat(world: World, number: int) -> bool:
    """Whether a filter changes little from pixel to pixel of a surface."""
    if number < 0 or number == _ground_number(world):
        return True
    return _part(world, number // 6, number % 6) < _ROUND


@_compiled
def _filter(
    world: World,
    start: _Vector,
    time: float,
    ray: _Vector,
    sides: tuple[_Vector, _Vector],
    t: float,
    number: int,
) -> _Filter:
    """How to average the texture where a ray meets a surface, if these are its changes."""
    if number == _SKY:
        return _NO_FILTER
    if number == _ground_number(world):
        return _ground_filter(world, _moved(start, ray, t), ray, sides, t)
    solid, face = number // 6, number % 6
    part = _part(world, solid, face)
    to = _local(world, solid, ray)
    changes = _local(world, solid, sides[0]), _local(world, solid, sides[1])
    if part < _ROUND:
        axis = part
        first, second = _slid_on_flat(axis, 2.0 * (face % 2) - 1.0, to, changes, t)
    else:
        hit = _moved(_local_point(world, solid, _beside(world, solid, start, time)), to, t)
        normal = _normal(world, solid, part, face, hit)
        axis = 0 if part == _SIDE else _longest(normal)
        first, second = _slid_on_round(world, solid, part, axis, normal, hit, to, changes, t)
    su, sv = world.scales[_at(solid), _at(axis), 0], world.scales[_at(solid), _at(axis), 1]
    scale = 0.0
    if world.stains[_at(solid), 0] > 0.0:
        scale = world.stains[_at(solid), 1]
    return _filter_over(first, second, su, sv, scale)


@_compiled
def _shade(
    world: World,
    start: _Vector,
    time: float,
    ray: _Vector,
    t: float,
    number: int,
    filter_: _Filter,
) -> float:
    """Radiance where a ray meets a surface."""
    if number == _SKY:
        return _sky(world, ray)
    if number == _ground_number(world):
        return _ground_shade(world, _moved(start, ray, t), filter_)
    solid, face = number // 6, number % 6
    part = _part(world, solid, face)
    to = _local(world, solid, ray)
    hit = _moved(_local_point(world, solid, _beside(world, solid, start, time)), to, t)
    normal = _normal(world, solid, part, face, hit)
    if part < _ROUND:
        axis = part
        at = _on_face(axis, 2.0 * (face % 2) - 1.0, hit)
    elif part == _SIDE:
        axis = 0
        at = _unrolled(world, solid, hit)
    else:
        axis = _longest(normal)
        at = _on_face(axis, 1.0 if normal[axis] > 0.0 else -1.0, hit)
    shade = _texture(world, solid, axis, part == _SIDE, at, filter_)
    return shade * _light(world, solid, part, normal, hit)


@_compiled
def _slid_on_flat(
    axis: int, sign: float, ray: _Vector, changes: tuple[_Vector, _Vector], t: float
) -> tuple[_Pair, _Pair]:
    """How a hit on the face of an axis changes to the right and down when the ray does."""
    facing = 1.0 / min(sign * ray[axis], -1e-9)
    along = _on_face(axis, sign, ray)
    first, second = _on_face(axis, sign, changes[0]), _on_face(axis, sign, changes[1])
    p, q = sign * changes[0][axis] * facing, sign * changes[1][axis] * facing
    return (
        (t * (first[0] - p * along[0]), t * (first[1] - p * along[1])),
        (t * (second[0] - q * along[0]), t * (second[1] - q * along[1])),
    )


@_compiled
def _slid_on_round(
    world: World,
    solid: int,
    part: int,
    axis: int,
    normal: _Vector,
    hit: _Vector,
    ray: _Vector,
    changes: tuple[_Vector, _Vector],
    t: float,
) -> tuple[_Pair, _Pair]:
    """As `_slid_on_flat`, on the side of a cylinder or on the face of an ellipsoid's cube."""
    facing = _facing(normal, ray)
    first, second = (
        _slid(ray, changes[0], normal, t, facing),
        _slid(ray, changes[1], normal, t, facing),
    )
    if part == _SIDE:
        turn = 1.0 if _runs_on(world, solid, hit) else -1.0
        tangent = (-turn * normal[1], turn * normal[0], 0.0)
        return (_dot(tangent, first), -first[2]), (_dot(tangent, second), -second[2])
    sign = 1.0 if normal[axis] > 0.0 else -1.0
    return _on_face(axis, sign, first), _on_face(axis, sign, second)


@_compiled
def _part(world: World, solid: int, face: int) -> int:
    """The part of a solid that a face is on: an axis for flat ones, _ROUND or _SIDE."""
    kind = world.kinds[_at(solid)]
    if kind == _BOX:
        return face // 2
    if kind == _ELLIPSOID:
        return _ROUND
    return 2 if face >= 4 else _SIDE


@_compiled
def _shape(world: World, solid: int) -> _Shape:
    """A solid's numbers as scalars, which stay in registers while arrays are written."""
    s = world.shapes[_at(solid)]
    return s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9], s[10]


@_compiled
def _speed(world: World, solid: int) -> _Vector:
    mover = solid - len(world.bounds)
    if mover < 0:
        return _ZERO
    speed = world.movers.velocities[mover]
    return speed[0], speed[1], speed[2]


@_compiled
def _beside(world: World, solid: int, start: _Vector, time: float) -> _Vector:
    """Where a point is relative to a solid's place at the frame's stamp."""
    mover = solid - len(world.bounds)
    if mover < 0:
        return start
    speed = world.movers.velocities[mover]
    return _moved(start, (speed[0], speed[1], speed[2]), -time)


@_compiled
def _span(world: World, solid: int, start: _Vector, ray: _Vector) -> _Pair:
    """Ray lengths at which a ray enters and leaves a solid; empty for a miss."""
    o, d = _local_point(world, solid, start), _local(world, solid, ray)
    kind, shape = world.kinds[_at(solid)], _shape(world, solid)
    if kind == _BOX:
        near, far, _ = _cut_box(o, d, shape)
    elif kind == _ELLIPSOID:
        near, far = _round_span(o, d, shape[8], shape[9], shape[10])
    else:
        near, far, _ = _cut_cylinder(o, d, shape)
    return near, far


@_compiled
def _cut_box(o: _Vector, d: _Vector, shape: _Shape) -> _Cut:
    """Where a ray is within a box."""
    cut = _cut_between((-np.inf, np.inf, 0.0), o[0], d[0], shape[3], 0.0)
    cut = _cut_between(cut, o[1], d[1], shape[4], 2.0)
    return _cut_between(cut, o[2], d[2], shape[5], 4.0)


@_compiled
def _cut_cylinder(o: _Vector, d: _Vector, shape: _Shape) -> _Cut:
    """Where a ray is within an upright cylinder; the face of its side is 0."""
    near, far, face = _cut_between((-np.inf, np.inf, 0.0), o[2], d[2], shape[5], 4.0)
    first, last = _round_span(o, d, shape[8], shape[9], 0.0)
    aside = first > near
    return (first if aside else near), min(far, last), (0.0 if aside else face)


@_compiled
def _cut_between(cut: _Cut, o: float, d: float, reach: float, face: float) -> _Cut:
    """What of a ray is also between two parallel faces, of which `face` is the first.

    A ray enters through the face that looks towards it.
    """
    near, far, before = cut
    inverse = 1.0 / (d if d != 0.0 else 1e-300)
    middle, half = -o * inverse, reach * abs(inverse)
    later = middle - half > near
    entered = face if d > 0.0 else face + 1.0
    return (
        (middle - half if later else near),
        min(far, middle + half),
        (entered if later else before),
    )


@_compiled
def _round_span(o: _Vector, d: _Vector, x: float, y: float, z: float) -> _Pair:
    """Where a ray is within the ellipsoid of half axes 1/x, 1/y, 1/z; empty for a miss."""
    ox, oy, oz, dx, dy, dz = o[0] * x, o[1] * y, o[2] * z, d[0] * x, d[1] * y, d[2] * z
    a = dx * dx + dy * dy + dz * dz
    inverse = 1.0 / a
    middle = -(ox * dx + oy * dy + oz * dz) * inverse
    # From the point of the ray closest to the middle: exact also for small things far away.
    px, py, pz = ox + middle * dx, oy + middle * dy, oz + middle * dz
    rest = 1.0 - (px * px + py * py + pz * pz)
    reach = math.sqrt(max(rest, 0.0) * inverse)
    near = middle - reach if rest >= 0.0 else np.inf
    far = middle + reach if rest >= 0.0 else -np.inf
    # Along a cylinder, it is within or without all the way.
    inside = ox * ox + oy * oy <= 1.0
    if a == 0.0:
        near = -np.inf if inside else np.inf
        far = np.inf if inside else -np.inf
    return near, far


@_compiled
def _normal(world: World, solid: int, part: int, face: int, hit: _Vector) -> _Vector:
    """Outward unit normal at a point of a face, in the solid's own frame."""
    if part < _ROUND:
        return _along(part, 2.0 * (face % 2) - 1.0)
    shape = world.shapes[_at(solid)]
    x, y = hit[0] * shape[8] * shape[8], hit[1] * shape[9] * shape[9]
    z = hit[2] * shape[10] * shape[10] if part == _ROUND else 0.0
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return scale * x, scale * y, scale * z


@_compiled
def _slid(ray: _Vector, change: _Vector, normal: _Vector, t: float, facing: float) -> _Vector:
    """How the hit point moves on the surface when the ray changes (Igehy 1999, eq. 10 to 12).

    `facing` is 1 / (normal · ray); the normal may have any length.
    """
    share = _dot(normal, change) * facing
    return (
        t * (change[0] - share * ray[0]),
        t * (change[1] - share * ray[1]),
        t * (change[2] - share * ray[2]),
    )


@_compiled
def _facing(normal: _Vector, ray: _Vector) -> float:
    return 1.0 / min(_dot(normal, ray), -1e-9)


@_compiled
def _sky(world: World, ray: _Vector) -> float:
    """Radiance of the sky: paler at the horizon, with soft clouds."""
    flat = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    slope = ray[2] / max(flat, 1e-9)
    radiance = world.sources.sky
    pale = 0.3 + 0.7 * radiance
    if slope <= 0.0:
        return pale
    rise = slope / np.sqrt(1.0 + slope * slope)
    mist = (1.0 - rise) ** 4
    spread = _CLOUDS_PER_TURN / (ray[2] + 0.25 * flat)
    value = _soft(world, 2, spread * ray[0], spread * ray[1])
    cloud = min(max(2.5 * (value - 0.5), 0.0), 1.0)
    clear = radiance + (0.97 - radiance) * cloud
    return float(clear + (pale - clear) * mist)


# --- Ground ----------------------------------------------------------------------------------


@_compiled
def _ground_number(world: World) -> int:
    return 6 * len(world.kinds)


@_compiled
def _ground_hit(world: World, start: _Vector, ray: _Vector, begin: float, end: float) -> float:
    """Ray length between begin and end at which a ray meets the ground; infinite for a miss.

    It walks over the blocks of the pyramid of peaks and leaps over those that it stays above.
    """
    relief = world.relief
    rows, columns = relief.heights.shape[0] - 1, relief.heights.shape[1] - 1
    scale = relief.per_m
    ox, oy = (start[0] - relief.corner[0]) * scale, (start[1] - relief.corner[1]) * scale
    dx, dy = scale * ray[0], scale * ray[1]
    ix, iy = _inverse(dx), _inverse(dy)
    first, second = -ox * ix, (columns - ox) * ix
    near, far = max(begin, min(first, second)), min(end, max(first, second))
    first, second = -oy * iy, (rows - oy) * iy
    t, far = max(near, min(first, second)), min(far, max(first, second))
    if not t < far:
        return np.inf
    j = min(max(int(ox + t * dx), 0), columns - 1)
    i = min(max(int(oy + t * dy), 0), rows - 1)
    level, top = 0, len(relief.starts) - 1  # what comes before was leapt over
    while True:
        bj, bi = j >> level, i >> level
        tx = (((bj + (dx > 0.0)) << level) - ox) * ix if dx != 0.0 else np.inf
        ty = (((bi + (dy > 0.0)) << level) - oy) * iy if dy != 0.0 else np.inf
        out = max(min(tx, ty, far), t)
        peak = relief.peaks[_at(relief.starts[_at(level)] + bi * relief.widths[_at(level)] + bj)]
        if start[2] + min(t * ray[2], out * ray[2]) <= peak:
            if level > 0:
                level -= 1
                continue
            hit = _cell_hit(world, i, j, (ox - j, oy - i, start[2]), (dx, dy, ray[2]), t, out)
            if hit < np.inf:
                return hit
        if out >= far:
            return np.inf
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
        up = level + 1
        if level < top and (j >> up != oj >> up or i >> up != oi >> up):
            level = up


@_compiled
def _ground_below(
    world: World, start: _Vector, ray: _Vector, between: tuple[float, float], guess: float
) -> float:
    """Ray length at which a ray meets the ground that it comes ever closer to between two lengths.

    So any meeting is the only one: it is looked for from a guess on, from cell to cell. Negative if
    it is not found.
    """
    relief = world.relief
    z, scale, t = relief.heights, relief.per_m, guess
    rows, columns = z.shape[0] - 1, z.shape[1] - 1
    ox, oy = (start[0] - relief.corner[0]) * scale, (start[1] - relief.corner[1]) * scale
    dx, dy = scale * ray[0], scale * ray[1]
    for _ in range(_GUESSES):
        x, y = ox + t * dx, oy + t * dy
        if not (0.0 <= x < columns and 0.0 <= y < rows):
            break
        j, i = int(x), int(y)
        z00, z01 = float(z[_at(i), _at(j)]), float(z[_at(i), _at(j + 1)])
        z10, z11 = float(z[_at(i + 1), _at(j)]), float(z[_at(i + 1), _at(j + 1)])
        a, b, c, e = z00, z01 - z00, z10 - z00, z11 - z10 - (z01 - z00)
        u, v = x - j, y - i
        above = start[2] + t * ray[2] - (a + b * u + c * v + e * u * v)
        slope = ray[2] - (b * dx + c * dy + e * (u * dy + v * dx))
        square = slope * slope + 4.0 * e * dx * dy * above
        if slope >= 0.0 or square < 0.0:
            break
        s = 2.0 * above / (math.sqrt(square) - slope)  # as in `_cell_hit`
        t, u, v = t + s, u + s * dx, v + s * dy
        if 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0:
            return t if between[0] <= t <= between[1] else -1.0
    return -1.0


@_compiled
def _cell_hit(
    world: World, i: int, j: int, o: _Vector, d: _Vector, begin: float, end: float
) -> float:
    """Where a ray, in the frame of a cell, meets its bilinear patch between two lengths."""
    z = world.relief.heights
    z00, z01 = float(z[_at(i), _at(j)]), float(z[_at(i), _at(j + 1)])
    z10, z11 = float(z[_at(i + 1), _at(j)]), float(z[_at(i + 1), _at(j + 1)])
    a, b, c, e = z00, z01 - z00, z10 - z00, z11 - z10 - (z01 - z00)
    u, v = o[0] + begin * d[0], o[1] + begin * d[1]
    above = o[2] + begin * d[2] - (a + b * u + c * v + e * u * v)
    if above <= 0.0:  # it went under just now, on the rim between two cells
        return begin
    slope = d[2] - (b * d[0] + c * d[1] + e * (u * d[1] + v * d[0]))
    bend = -e * d[0] * d[1]
    # The smaller positive root of above + slope s + bend s^2, without cancellation.
    square = slope * slope - 4.0 * bend * above
    if square < 0.0:
        return np.inf
    root = np.sqrt(square)
    if slope <= 0.0:
        s = 2.0 * above / (root - slope) if root - slope > 0.0 else np.inf
    else:
        s = -(slope + root) / (2.0 * bend) if bend < 0.0 else np.inf
    return begin + s if s <= end - begin else np.inf


@_compiled
def _ground_normal(world: World, x: float, y: float) -> _Vector:
    """Normal of the patch below a point, of no particular length."""
    z = world.relief.heights
    i, j, v, u = _spot(world, x, y, 1, z)
    scale = world.relief.per_m
    z00, z01 = z[_at(i), _at(j)], z[_at(i), _at(j + 1)]
    z10, z11 = z[_at(i + 1), _at(j)], z[_at(i + 1), _at(j + 1)]
    across, beyond, up, after = z01 - z00, z11 - z10, z10 - z00, z11 - z01
    gx, gy = scale * (across + v * (beyond - across)), scale * (up + u * (after - up))
    return -gx, -gy, 1.0


@_compiled
def _spot(
    world: World, x: float, y: float, finer: int, grid: Floats32
) -> tuple[int, int, float, float]:
    """Row, column and their fractions on a grid that is so much finer than the ground's."""
    relief = world.relief
    scale = finer * relief.per_m
    right, up = scale * (x - relief.corner[0]), scale * (y - relief.corner[1])
    right = min(max(right, 0.0), grid.shape[1] - 1.0)
    up = min(max(up, 0.0), grid.shape[0] - 1.0)
    j, i = min(int(right), grid.shape[1] - 2), min(int(up), grid.shape[0] - 2)
    return i, j, up - i, right - j


@_compiled
def _between(grid: Floats32, spot: tuple[int, int, float, float]) -> float:
    """A grid's value there, bilinear."""
    i, j, v, u = spot
    z00, z01 = grid[_at(i), _at(j)], grid[_at(i), _at(j + 1)]
    z10, z11 = grid[_at(i + 1), _at(j)], grid[_at(i + 1), _at(j + 1)]
    near, far = z00 + u * (z01 - z00), z10 + u * (z11 - z10)
    return float(near + v * (far - near))


@_compiled
def _ground_filter(
    world: World, hit: _Vector, ray: _Vector, sides: tuple[_Vector, _Vector], t: float
) -> _Filter:
    relief = world.relief
    normal = _ground_normal(world, hit[0], hit[1])
    facing = _facing(normal, ray)
    a, d = _slid(ray, sides[0], normal, t, facing), _slid(ray, sides[1], normal, t, facing)
    k, scale = relief.density, 0.0
    if relief.stain > 0.0:
        scale = relief.stain_scale
    return _filter_over((a[0], a[1]), (d[0], d[1]), k, -k, scale)


@_compiled
def _ground_shade(world: World, hit: _Vector, filter_: _Filter) -> float:
    """Shade of the ground: its texture laid on from above, stains and baked light."""
    relief = world.relief
    k = relief.density
    value = _filtered(world, relief.texture, k * hit[0], -k * hit[1], filter_)
    if relief.stain > 0.0:
        k = relief.stain_scale
        value *= 1.0 + 2.0 * relief.stain * (_stain(world, k * hit[0], -k * hit[1], filter_) - 0.5)
    return value * _ground_light(world, hit[0], hit[1])


@_compiled
def _ground_light(world: World, x: float, y: float) -> float:
    light = world.relief.light
    return _between(light, _spot(world, x, y, world.relief.finer, light))


# --- Frames ----------------------------------------------------------------------------------


@_compiled
def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_compiled
def _moved(start: _Vector, direction: _Vector, by: float) -> _Vector:
    return (
        start[0] + by * direction[0],
        start[1] + by * direction[1],
        start[2] + by * direction[2],
    )


@_compiled
def _minus(a: _Vector, b: _Vector) -> _Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@_compiled
def _least(a: _Vector, b: _Vector) -> _Vector:
    return min(a[0], b[0]), min(a[1], b[1]), min(a[2], b[2])


@_compiled
def _greatest(a: _Vector, b: _Vector) -> _Vector:
    return max(a[0], b[0]), max(a[1], b[1]), max(a[2], b[2])


@_compiled
def _turned(turn: _Turn, v: _Vector) -> _Vector:
    return _dot(turn[0], v), _dot(turn[1], v), _dot(turn[2], v)


@_compiled
def _turned_flat(turn: _Turn, v: _Pair) -> _Vector:
    return (
        turn[0][0] * v[0] + turn[0][1] * v[1],
        turn[1][0] * v[0] + turn[1][1] * v[1],
        turn[2][0] * v[0] + turn[2][1] * v[1],
    )


@_compiled
def _turned_back(turn: _Turn, v: _Vector) -> _Vector:
    return (
        turn[0][0] * v[0] + turn[1][0] * v[1] + turn[2][0] * v[2],
        turn[0][1] * v[0] + turn[1][1] * v[1] + turn[2][1] * v[2],
        turn[0][2] * v[0] + turn[1][2] * v[1] + turn[2][2] * v[2],
    )


@_compiled
def _local_point(world: World, solid: int, point: _Vector) -> _Vector:
    """A point of the world in the solid's own frame."""
    shape = world.shapes[_at(solid)]
    return _local(world, solid, (point[0] - shape[0], point[1] - shape[1], point[2] - shape[2]))


@_compiled
def _local(world: World, solid: int, vector: _Vector) -> _Vector:
    """A direction of the world in the solid's own frame."""
    cosine, sine = world.shapes[_at(solid), 6], world.shapes[_at(solid), 7]
    return (
        cosine * vector[0] + sine * vector[1],
        cosine * vector[1] - sine * vector[0],
        vector[2],
    )


@_compiled
def _upright(world: World, solid: int, vector: _Vector) -> _Vector:
    """A direction of the solid's own frame in the world."""
    cosine, sine = world.shapes[_at(solid), 6], world.shapes[_at(solid), 7]
    return (
        cosine * vector[0] - sine * vector[1],
        sine * vector[0] + cosine * vector[1],
        vector[2],
    )


@_compiled
def _along(axis: int, length: float) -> _Vector:
    return (
        length if axis == 0 else 0.0,
        length if axis == 1 else 0.0,
        length if axis == 2 else 0.0,
    )


@_compiled
def _longest(vector: _Vector) -> int:
    x, y, z = abs(vector[0]), abs(vector[1]), abs(vector[2])
    if x >= y and x >= z:
        return 0
    return 1 if y >= z else 2


@_compiled
def _face_of(axis: int, vector: _Vector) -> int:
    return 2 * axis + (1 if vector[axis] > 0.0 else 0)


# --- Texture ---------------------------------------------------------------------------------


@_compiled
def _texture(
    world: World, solid: int, axis: int, is_side: bool, at: _Pair, filter_: _Filter
) -> float:
    """Averaged texture at a point of a face, given in metres right and down."""
    right, low = at
    su, sv = world.scales[_at(solid), _at(axis), 0], world.scales[_at(solid), _at(axis), 1]
    texture = world.textures[_at(solid)]
    u = su * right + world.offsets[_at(solid), 0] + 0.5 * world.atlas.levels[texture, 0, 2]
    v = sv * low + world.offsets[_at(solid), 1] + 0.5 * world.atlas.levels[texture, 0, 1]
    value = _filtered(world, texture, u, v, filter_)
    if world.stains[_at(solid), 0] > 0.0:
        scale = world.stains[_at(solid), 1]
        shift = 57.3 * solid  # so that no two solids have the same stains
        # Mirrored on round things, so that it has no seam either.
        aside = abs(right) if is_side else right
        stain = _stain(world, scale * aside + shift, scale * low + 0.7 * shift, filter_)
        value *= 1.0 + 2.0 * world.stains[_at(solid), 0] * (stain - 0.5)
    return value


@_compiled
def _unrolled(world: World, solid: int, hit: _Vector) -> _Pair:
    """Right and down on a cylinder's side.

    A texture too wide for the cylinder runs half around and back, so that it has no seam.
    """
    shape = world.shapes[_at(solid)]
    angle = np.arctan2(hit[1] * shape[9], hit[0] * shape[8])
    radius = 0.5 * (shape[3] + shape[4])
    return radius * (angle if _runs_on(world, solid, hit) else -angle), -hit[2]


@_compiled
def _runs_on(world: World, solid: int, hit: _Vector) -> bool:
    """Whether the texture of a cylinder's side runs with the angle there."""
    return bool(world.goes_round[_at(solid)] or hit[1] >= 0.0)


@_compiled
def _on_face(axis: int, sign: float, local: _Vector) -> _Pair:
    """Right and down on a face as seen from outside, so that print reads the right way."""
    if axis == 0:
        return sign * local[1], -local[2]
    if axis == 1:
        return -sign * local[0], -local[2]
    return local[0], -sign * local[1]


@_compiled
def _stain(world: World, u: float, v: float, filter_: _Filter) -> float:
    """The stain, 0…1, at a point given in its texels."""
    level, shrink = filter_[6], filter_[7]
    return _soft(world, level, shrink * u, shrink * v)


@_compiled
def _level(square: float) -> _Level:
    """Mip-map level for a footprint of so many texels squared."""
    level, shrink = 0, 1.0
    while square >= 4.0 and level < LEVELS - 1:
        square, level, shrink = 0.25 * square, level + 1, 0.5 * shrink
    # Straight lines instead of the logarithm; half of the time one level is enough.
    share = square - 1.5 if square < 2.0 else 0.5 * square - 0.5
    if level == LEVELS - 1:
        share = 0.0
    return level, shrink, min(max(share, 0.0), 1.0)


@_compiled
def _filter_over(first: _Pair, second: _Pair, su: float, sv: float, stain: float) -> _Filter:
    """How to average over a footprint with these sides in metres right and down.

    `su` and `sv` are the texels per metre of the texture, `stain` those of the stain.
    """
    size = stain * max(abs(first[0]) + abs(second[0]), abs(first[1]) + abs(second[1]))
    soft, less, part = _level(size * size)
    if part > 0.5:  # it is soft: the nearer level will do
        soft, less = soft + 1, 0.5 * less
    first, second = (su * first[0], sv * first[1]), (su * second[0], sv * second[1])
    long = first[0] * first[0] + first[1] * first[1]
    short = second[0] * second[0] + second[1] * second[1]
    along = first
    if short > long:
        long, short, along = short, long, second
    count, wide = 1, max(short, 1.0)  # rather a little blur than aliasing
    if long > _ONE_SAMPLE * wide:
        count = 2
        while count < _MAX_ANISOTROPY and long >= (count + 0.6) ** 2 * wide:
            count += 1
    step = _INVERSE[count]
    level, shrink, share = _level(max(short, long * step * step))
    return level, count, share, shrink * _ONE_TEXEL, along[0], along[1], soft, less


@_compiled
def _filtered(world: World, texture: int, u: float, v: float, filter_: _Filter) -> float:
    """The mean of samples, 0…1, along the longer side of a footprint about a point in texels."""
    level, count, share, scale, right, low, _, _ = filter_
    step = _INVERSE[count]
    first_sample = 0.5 * (step - 1.0)
    x, y = int(scale * (u + first_sample * right)), int(scale * (v + first_sample * low))
    dx, dy = int(scale * step * right), int(scale * step * low)
    total = 0.0
    if share < 1.0:
        total = _along_line(world, texture, level, (x, y), (dx, dy), count)
    if share > 0.0:
        x, y, dx, dy = x >> 1, y >> 1, dx >> 1, dy >> 1
        softer = _along_line(world, texture, level + 1, (x, y), (dx, dy), count)
        total += share * (softer - total)
    return step * total * _PER_GREY


@_compiled
def _along_line(
    world: World,
    texture: int,
    level: int,
    at: tuple[int, int],
    step: tuple[int, int],
    count: int,
) -> float:
    """Sum of evenly spaced samples of a texture."""
    (x, y), total = at, 0
    for _ in range(count):
        total += _bilinear(world, texture, level, x, y)
        x, y = x + step[0], y + step[1]
    return float(total)


@_compiled
def _bilinear(world: World, texture: int, level: int, x: int, y: int) -> int:
    """A texture, 0…255 · 2^32, at a point given in 2^-16 texels of a level."""
    levels = world.atlas.levels
    start, height, width = (
        levels[_at(texture), _at(level), 0],
        levels[_at(texture), _at(level), 1],
        levels[_at(texture), _at(level), 2],
    )
    x, y = x - (1 << (_BITS - 1)), y - (1 << (_BITS - 1))
    j, i = (x >> _BITS) & (width - 1), (y >> _BITS) & (height - 1)
    j1, i1 = (j + 1) & (width - 1), (i + 1) & (height - 1)
    fu, fv = x & _FRACTION, y & _FRACTION
    upper, lower = start + i * width, start + i1 * width
    a, b = _texel(world, upper + j), _texel(world, lower + j)
    a = (a << _BITS) + fu * (_texel(world, upper + j1) - a)
    b = (b << _BITS) + fu * (_texel(world, lower + j1) - b)
    return (a << _BITS) + fv * (b - a)


@_compiled
def _texel(world: World, at: int) -> int:
    return int(np.int64(world.atlas.texels[_at(at)]))  # signed, lest sums become floats


@_compiled
def _soft(world: World, level: int, u: float, v: float) -> float:
    """The stain, 0…1, at a point given in texels of a level."""
    x, y = int(_ONE_TEXEL * u), int(_ONE_TEXEL * v)
    return _bilinear(world, len(world.atlas.levels) - 1, level, x, y) * _PER_GREY


# --- Light on surfaces -----------------------------------------------------------------------


@_compiled
def _light(world: World, solid: int, part: int, normal: _Vector, hit: _Vector) -> float:
    """Light at a point of a solid: baked, bilinear; or simple on what moves."""
    mover = solid - len(world.bounds)
    if mover >= 0:
        return _simple_light(world, mover, _upright(world, solid, normal))
    shape = world.shapes[_at(solid)]
    p = (hit[0] * shape[8], hit[1] * shape[9], hit[2] * shape[10])
    axis = part
    if part == _SIDE:
        axis = _longest((p[0], p[1], 0.0))
        scale = 1.0 / abs(p[axis])
        p = (p[0] * scale, p[1] * scale, p[2])
    elif part == _ROUND:
        axis = _longest(p)
        p = _moved(_ZERO, p, 1.0 / abs(p[axis]))
    first, second = 1 if axis == 0 else 0, 1 if axis == 2 else 2
    return _baked(world, solid, _face_of(axis, p), p[first], p[second])


@_compiled
def _baked(world: World, solid: int, face: int, right: float, up: float) -> float:
    """Light at a point of a face, -1…1 along its own axes."""
    grids, values = world.lights.grids, world.lights.values
    rows, columns = grids[_at(solid), _at(face), 1], grids[_at(solid), _at(face), 2]
    right, up = (0.5 + 0.5 * right) * (columns - 1), (0.5 + 0.5 * up) * (rows - 1)
    j = min(max(int(right), 0), columns - 2)
    i = min(max(int(up), 0), rows - 2)
    # A mean of hits may lie a little beside a face.
    fu, fv = min(max(right - j, 0.0), 1.0), min(max(up - i, 0.0), 1.0)
    at = grids[_at(solid), _at(face), 0] + i * columns + j
    return float(
        (1.0 - fv) * ((1.0 - fu) * values[_at(at)] + fu * values[_at(at + 1)])
        + fv * ((1.0 - fu) * values[_at(at + columns)] + fu * values[_at(at + columns + 1)])
    )


@_compiled
def _simple_light(world: World, mover: int, normal: _Vector) -> float:
    """Light on a solid that moves: from above, and half of it from all around."""
    light = world.movers.lights[mover]
    facing = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    return float(max(facing, 0.0) + light[3] * (0.8 + 0.2 * normal[2]))


# --- Baking ----------------------------------------------------------------------------------


@_entry
def light_faces(
    world: World,
    faces: tuple[int, int],
    lamps: Floats,
    lamp_points: Floats,
    to_sky: Floats,
) -> None:
    """Bake the light on faces faces[0]…faces[1] - 1, where face = 6 * solid + side.

    Args:
        world: its `lights.values` are written.
        faces: range of faces.
        lamps: (L, 5) centre, power and reach.
        lamp_points: (L, P, 3) points of each lamp, the first four of them its corners.
        to_sky: (K, 3) directions above a surface, its outward last, with their lengths.
    """
    lights, close = world.lights, np.empty(len(world.kinds), np.int64)
    for number in range(faces[0], faces[1]):
        solid, face = number // 6, number % 6
        begin, rows, columns = lights.grids[solid, face]
        for i in range(rows):
            for j in range(columns):
                right, up = 2.0 * j / (columns - 1) - 1.0, 2.0 * i / (rows - 1) - 1.0
                point, normal = _surface_point(world, solid, face, right, up)
                tint = _tint(normal)
                here = _moved(point, normal, _LIFT_M)
                shape = world.shapes[solid]
                here = _moved(_upright(world, solid, here), (shape[0], shape[1], shape[2]), 1.0)
                outward = _upright(world, solid, normal)
                lights.values[begin + i * columns + j] = _all_light(
                    world, here, outward, tint, solid, lamps, lamp_points, to_sky, close
                )


@_entry
def light_ground(
    world: World, band: tuple[int, int], lamps: Floats, lamp_points: Floats, to_sky: Floats
) -> None:
    """Bake the light on rows band[0]…band[1] - 1 of the ground; `relief.light` is written."""
    relief = world.relief
    light, step = relief.light, relief.cell / relief.finer
    close = np.empty(len(world.kinds), np.int64)
    for i in range(band[0], band[1]):
        for j in range(light.shape[1]):
            x, y = relief.corner[0] + step * j, relief.corner[1] + step * i
            normal = _smooth_normal(world, x, y)
            here = _moved((x, y, _height(world, x, y)), normal, _LIFT_M)
            light[i, j] = _all_light(
                world, here, normal, 1.1, _GROUND, lamps, lamp_points, to_sky, close
            )


@_compiled
def _smooth_normal(world: World, x: float, y: float) -> _Vector:
    """Unit normal of the ground from heights a cell away, so that cells do not show."""
    cell = world.relief.cell
    gx = (_height(world, x + cell, y) - _height(world, x - cell, y)) / (2.0 * cell)
    gy = (_height(world, x, y + cell) - _height(world, x, y - cell)) / (2.0 * cell)
    scale = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
    return -scale * gx, -scale * gy, scale


@_compiled
def _height(world: World, x: float, y: float) -> float:
    heights = world.relief.heights
    return _between(heights, _spot(world, x, y, 1, heights))


@_entry
def light_movers(world: World, centres: Floats, lights: Floats) -> None:
    """Light (K, 4) that falls on moving solids at these places: direction and ambient.

    From the sun and from lamps where they are in sight.
    """
    sources = world.sources
    for k in range(len(centres)):
        here = (centres[k, 0], centres[k, 1], centres[k, 2])
        total = _ZERO
        sun = (sources.sun[0], sources.sun[1], sources.sun[2])
        if sources.sun_power > 0.0 and (
            _blocker(world, here, _moved(_ZERO, sun, _FAR_M), _GROUND) < 0
        ):
            total = _moved(total, sun, sources.sun_power)
        for lamp in range(len(sources.lamps)):
            x, y, z, power, reach = sources.lamps[lamp]
            to = _minus((x, y, z), here)
            square = _dot(to, to)
            if power > 0.004 * (1.0 + square / reach**2) and _blocker(world, here, to, _GROUND) < 0:
                total = _moved(total, to, power / np.sqrt(square) / (1.0 + square / reach**2))
        lights[k, 0], lights[k, 1], lights[k, 2] = total
        lights[k, 3] = sources.ambient


@_compiled
def _all_light(
    world: World,
    here: _Vector,
    normal: _Vector,
    tint: float,
    guess: int,
    lamps: Floats,
    lamp_points: Floats,
    to_sky: Floats,
    close: Ints,
) -> float:
    """Light at a point from all around, from the sun and from lamps."""
    open_share = _open_share(world, here, normal, to_sky, close)
    total = world.sources.ambient * tint * (_DARKEST + (1.0 - _DARKEST) * open_share)
    sun = (world.sources.sun[0], world.sources.sun[1], world.sources.sun[2])
    facing = _dot(normal, sun)
    if facing > 0.0 and _blocker(world, here, _moved(_ZERO, sun, _FAR_M), guess) < 0:
        total += world.sources.sun_power * facing
    for k in range(len(lamps)):
        total += _lamp_light(world, here, normal, lamps[k], lamp_points[k], guess)
    return total


@_compiled
def _tint(normal: _Vector) -> float:
    """Faces get a little different ambient light, so that edges show also in the shade."""
    x = 0.08 if normal[0] > 0.0 else -0.04
    y = 0.03 if normal[1] > 0.0 else -0.07
    z = 0.1 if normal[2] > 0.0 else -0.1
    return 1.0 + x * normal[0] ** 2 + y * normal[1] ** 2 + z * normal[2] ** 2


@_compiled
def _surface_point(
    world: World, solid: int, face: int, right: float, up: float
) -> tuple[_Vector, _Vector]:
    """Point and normal on a solid, in its own frame, for a point -1…1 of a face of its cube."""
    axis, sign = face // 2, 1.0 if face % 2 == 1 else -1.0
    if axis == 0:
        p = (sign, right, up)
    elif axis == 1:
        p = (right, sign, up)
    else:
        p = (right, up, sign)
    kind, shape = world.kinds[solid], world.shapes[solid]
    normal = _along(axis, sign)
    if kind == _ELLIPSOID:
        p = _moved(_ZERO, p, 1.0 / np.sqrt(_dot(p, p)))
    elif kind != _BOX:
        flat = np.sqrt(p[0] * p[0] + p[1] * p[1])
        if axis < 2 or flat > 1.0:
            p = (p[0] / flat, p[1] / flat, p[2])
    hit = (p[0] * shape[3], p[1] * shape[4], p[2] * shape[5])
    if kind == _ELLIPSOID:
        normal = _normal(world, solid, _ROUND, 0, hit)
    elif kind != _BOX and axis < 2:
        normal = _normal(world, solid, _SIDE, 0, hit)
    return hit, normal


@_compiled
def _open_share(world: World, here: _Vector, normal: _Vector, to_sky: Floats, close: Ints) -> float:
    """Share of the directions (K, 3) above a surface that meet nothing within their length.

    `close` is room for a list of solids.
    """
    count = _list_close(world, here, _reach(to_sky), close)
    first, second = _tangents(normal)
    has_ground = world.relief.heights.shape[0] > 1
    clear, guess = 0, 0
    if count > _FEW_CLOSE:
        guess = close[0]
    for k in range(len(to_sky)):
        ray = _moved(_ZERO, first, to_sky[k, 0])
        ray = _moved(ray, second, to_sky[k, 1])
        ray = _moved(ray, normal, to_sky[k, 2])
        blocked = False
        if count > _FEW_CLOSE:
            blocker = _blocker(world, here, ray, guess)
            clear += blocker < 0
            guess = blocker if blocker >= 0 else guess
            continue
        for other in range(count):
            solid = close[(guess + other) % count]
            if _blocks(world, solid, here, ray):
                guess, blocked = (guess + other) % count, True
                break
        if not blocked and has_ground:
            blocked = _ground_hit(world, here, ray, 0.0, 1.0) < 1.0
        clear += not blocked
    return clear / len(to_sky)


@_compiled
def _reach(to_sky: Floats) -> float:
    return math.sqrt(to_sky[0, 0] ** 2 + to_sky[0, 1] ** 2 + to_sky[0, 2] ** 2)


@_compiled
def _list_close(world: World, here: _Vector, reach: float, close: Ints) -> int:
    """List the solids that may be within a distance of a point."""
    tree = world.tree
    b = tree.bounds
    node, count = 0, 0
    while node < len(tree.skip):
        if (
            b[node, 0] > here[0] + reach
            or b[node, 1] > here[1] + reach
            or b[node, 2] > here[2] + reach
            or b[node, 3] < here[0] - reach
            or b[node, 4] < here[1] - reach
            or b[node, 5] < here[2] - reach
        ):
            node = tree.skip[node]
            continue
        if tree.solid[node] >= 0:
            close[count] = tree.solid[node]
            count += 1
        node += 1
    return count


@_compiled
def _tangents(normal: _Vector) -> tuple[_Vector, _Vector]:
    """Two directions across a unit vector and each other (Duff et al. 2017)."""
    x, y, z = normal
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


@_compiled
def _lamp_light(
    world: World, here: _Vector, normal: _Vector, lamp: Floats, points: Floats, guess: int
) -> float:
    """Light from the points (P, 3) of a lamp, each counted where it is in sight."""
    to = (lamp[0] - here[0], lamp[1] - here[1], lamp[2] - here[2])
    if lamp[3] < 0.004 * (1.0 + _dot(to, to) / lamp[4] ** 2):
        return 0.0
    total, hidden = 0.0, 0
    for k in range(len(points)):
        if k == 4 and (hidden == 0 or hidden == 4):  # all corners agree: so will the rest
            return float(lamp[3] * total / 4.0)
        to = (points[k, 0] - here[0], points[k, 1] - here[1], points[k, 2] - here[2])
        facing = _dot(normal, to)
        if facing <= 0.0:
            hidden += 1
            continue
        blocker = _blocker(world, here, to, guess)
        if blocker >= 0:
            guess = blocker
            hidden += 1
            continue
        square = _dot(to, to)
        total += facing / np.sqrt(square) / (1.0 + square / lamp[4] ** 2)
    return float(lamp[3] * total / len(points))


@_compiled
def _blocker(world: World, start: _Vector, ray: _Vector, guess: int) -> int:
    """A solid or the ground between start and start + ray, or -1; `guess` is tried first."""
    if guess != _GROUND and _blocks(world, guess, start, ray):
        return guess
    inverse = (_inverse(ray[0]), _inverse(ray[1]), _inverse(ray[2]))
    tree = world.tree
    node = 0
    while node < len(tree.skip):
        if _misses(tree.bounds, node, start, inverse):
            node = tree.skip[node]
            continue
        leaf = tree.solid[node]
        if leaf >= 0 and _blocks(world, leaf, start, ray):
            return int(leaf)
        node += 1
    if world.relief.heights.shape[0] > 1 and _ground_hit(world, start, ray, 0.0, 1.0) < 1.0:
        return _GROUND
    return -1


@_compiled
def _blocks(world: World, solid: int, start: _Vector, ray: _Vector) -> bool:
    """Whether a solid is between start and start + ray, or start is inside it."""
    near, far = _span(world, solid, start, ray)
    return max(near, 0.0) < min(far, 1.0)


@_compiled
def _inverse(value: float) -> float:
    return 1.0 / (value if value != 0.0 else 1e-300)


@_compiled
def _misses(bounds: Floats, node: int, start: _Vector, inverse: _Vector) -> bool:
    near, far = 0.0, 1.0
    for k in range(3):
        first = (bounds[node, k] - start[k]) * inverse[k]
        second = (bounds[node, k + 3] - start[k]) * inverse[k]
        near, far = max(near, min(first, second)), min(far, max(first, second))
    return near > far
