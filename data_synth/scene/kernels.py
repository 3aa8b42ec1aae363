"""Compiled kernels: which box a ray meets, its filtered texture, and the light on faces.

All in one file, because numba's cache only notices changes in the file that holds a function, not
in those that it calls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from data_synth.scene.atlas import LEVELS
from data_synth.scene.world import World
from vo.types import Floats, Floats32, Ints

SKY = 0.8
TILE = 16
_MAX_ANISOTROPY = 8
_EDGE_GRID = 3

_F = TypeVar("_F", bound=Callable[..., Any])
_Vector = tuple[float, float, float]
_Boxes = tuple[Ints, Floats]  # numbers, and ray lengths below which each cannot be met
_ZERO = (0.0, 0.0, 0.0)


def _entry(function: _F) -> _F:
    """Compile what Python calls; it frees the GIL, so that threads can share the work."""
    return cast(_F, numba.njit(nogil=True, cache=True, error_model="numpy")(function))


def _compiled(function: _F) -> _F:
    """Compile what kernels call: it may not make arrays.

    Counting references to the arrays of `World` at each call would take 70 % of the time.
    """
    options: dict[str, Any] = {"error_model": "numpy", "forceinline": True, "_nrt": False}
    return cast(_F, numba.njit(**options)(function))


@_entry
def cast_rows(
    world: World,
    rays: Floats,
    rotation: Floats,
    origin: Floats,
    band: tuple[int, int],
    image: Floats32,
    depth: Floats32,
    surface: NDArray[np.int32],
) -> None:
    """One ray for each pixel of rows band[0]…band[1]: shade, depth and what was hit."""
    start = (origin[0], origin[1], origin[2])
    boxes, starts = _empty_list(world)
    for top in range(band[0], band[1], TILE):
        bottom = min(top + TILE, band[1])
        for left in range(0, rays.shape[1], TILE):
            right = min(left + TILE, rays.shape[1])
            count = _list_boxes(
                world, start, rays, rotation, (top, bottom, left, right), boxes, starts
            )
            seen = (boxes[:count], starts[:count])
            for row in range(top, bottom):
                for column in range(left, right):
                    ray, across, down = _ray(rays, row, column, rotation)
                    shade, t, face = _radiance(
                        world, start, ray, across, down, seen, _MAX_ANISOTROPY
                    )
                    image[row, column] = shade
                    depth[row, column] = t * rays[row, column, 2]
                    surface[row, column] = face


@_entry
def smooth_rows(
    world: World,
    rays: Floats,
    rotation: Floats,
    origin: Floats,
    band: tuple[int, int],
    image: Floats32,
    surface: NDArray[np.int32],
) -> None:
    """More rays for the pixels beside an edge of rows band[0]…band[1]."""
    start = (origin[0], origin[1], origin[2])
    boxes, starts = _empty_list(world)
    for top in range(band[0], band[1], TILE):
        bottom = min(top + TILE, band[1])
        for left in range(0, rays.shape[1], TILE):
            right = min(left + TILE, rays.shape[1])
            count = _list_boxes(
                world, start, rays, rotation, (top, bottom, left, right), boxes, starts
            )
            seen = (boxes[:count], starts[:count])
            for row in range(top, bottom):
                for column in range(left, right):
                    if _is_edge(surface, row, column):
                        ray, across, down = _ray(rays, row, column, rotation)
                        image[row, column] = _mean_radiance(world, start, ray, across, down, seen)


@_compiled
def _mean_radiance(
    world: World, start: _Vector, ray: _Vector, across: _Vector, down: _Vector, seen: _Boxes
) -> float:
    """Mean shade of a grid of rays within one pixel."""
    step = 1.0 / _EDGE_GRID
    across, down = _moved(_ZERO, across, step), _moved(_ZERO, down, step)
    total = 0.0
    for i in range(_EDGE_GRID * _EDGE_GRID):
        shifted = _moved(ray, across, i % _EDGE_GRID - 0.5 * (_EDGE_GRID - 1))
        shifted = _moved(shifted, down, i // _EDGE_GRID - 0.5 * (_EDGE_GRID - 1))
        # The rays are close already, so that one sample of the texture is enough.
        total += _radiance(world, start, shifted, across, down, seen, 1)[0]
    return total / (_EDGE_GRID * _EDGE_GRID)


@_entry
def _empty_list(world: World) -> _Boxes:
    return np.empty(len(world.centres), np.int64), np.empty(len(world.centres))


@_compiled
def _list_boxes(
    world: World,
    start: _Vector,
    rays: Floats,
    rotation: Floats,
    tile: tuple[int, int, int, int],
    boxes: Ints,
    starts: Floats,
) -> int:
    """List the boxes that any ray of a tile may meet, by the shortest length at which it may."""
    low, high = _ray_range(rays, rotation, tile)
    node, count = 0, 0
    while node < len(world.node_skip):
        near = _earliest(world.node_bounds, node, start, low, high)
        if near == np.inf:
            node = world.node_skip[node]
            continue
        if world.node_box[node] >= 0:
            at = count
            while at > 0 and starts[at - 1] > near:
                boxes[at], starts[at] = boxes[at - 1], starts[at - 1]
                at -= 1
            boxes[at], starts[at] = world.node_box[node], near
            count += 1
        node += 1
    return count


@_compiled
def _ray_range(
    rays: Floats, rotation: Floats, tile: tuple[int, int, int, int]
) -> tuple[_Vector, _Vector]:
    """Least and greatest x, y, z of a tile's rays in the world, a pixel wider all round."""
    low, high = (np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf)
    for row in range(tile[0], tile[1]):
        for column in range(tile[2], tile[3]):
            x, y, z = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
            ray = _turned(rotation, x, y, z)
            low = (min(low[0], ray[0]), min(low[1], ray[1]), min(low[2], ray[2]))
            high = (max(high[0], ray[0]), max(high[1], ray[1]), max(high[2], ray[2]))
    _, across, down = _ray(rays, tile[0], tile[2], rotation)
    x, y, z = (
        abs(across[0]) + abs(down[0]),
        abs(across[1]) + abs(down[1]),
        abs(across[2]) + abs(down[2]),
    )
    return (low[0] - x, low[1] - y, low[2] - z), (high[0] + x, high[1] + y, high[2] + z)


@_compiled
def _earliest(bounds: Floats, node: int, start: _Vector, low: _Vector, high: _Vector) -> float:
    """Lower bound of the length at which rays between low and high meet a node; or infinite."""
    near, far = 0.0, np.inf
    for k in range(3):
        first, last = bounds[node, k] - start[k], bounds[node, k + 3] - start[k]
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


@_entry
def light_face(
    world: World,
    box: int,
    face: int,
    to_lamp: Floats,
    to_sky: Floats,
    lamp_reach_m: float,
    light: Floats32,
) -> None:
    """Light on a grid of points (rows, columns, 2) of a face: open sky share, then lamp."""
    axis, sign = face // 2, 1.0 if face % 2 == 1 else -1.0
    rows, columns = light.shape[:2]
    for i in range(rows):
        for j in range(columns):
            here = _face_point(world, box, axis, sign, j / (columns - 1), i / (rows - 1))
            light[i, j, 0] = _open_share(world, here, axis, sign, box, to_sky)
            light[i, j, 1] = _lamp_light(world, here, axis, sign, box, to_lamp, lamp_reach_m)


@_compiled
def _ray(rays: Floats, row: int, column: int, rotation: Floats) -> tuple[_Vector, _Vector, _Vector]:
    """A pixel's ray in the world and how it changes by one pixel across and down."""
    x, y, z = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
    j = 1 if column + 1 < rays.shape[1] else -1
    i = 1 if row + 1 < rays.shape[0] else -1
    across, down = rays[row, column + j], rays[row + i, column]
    return (
        _turned(rotation, x, y, z),
        _turned(rotation, j * (across[0] - x), j * (across[1] - y), j * (across[2] - z)),
        _turned(rotation, i * (down[0] - x), i * (down[1] - y), i * (down[2] - z)),
    )


@_compiled
def _turned(rotation: Floats, x: float, y: float, z: float) -> _Vector:
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@_compiled
def _moved(start: _Vector, direction: _Vector, by: float) -> _Vector:
    return (
        start[0] + by * direction[0],
        start[1] + by * direction[1],
        start[2] + by * direction[2],
    )


@_compiled
def _is_edge(surface: NDArray[np.int32], row: int, column: int) -> bool:
    here = surface[row, column]
    rows, columns = surface.shape
    return bool(
        (row > 0 and surface[row - 1, column] != here)
        or (row + 1 < rows and surface[row + 1, column] != here)
        or (column > 0 and surface[row, column - 1] != here)
        or (column + 1 < columns and surface[row, column + 1] != here)
    )


@_compiled
def _radiance(
    world: World,
    start: _Vector,
    ray: _Vector,
    across: _Vector,
    down: _Vector,
    seen: _Boxes,
    samples: int,
) -> tuple[float, float, int]:
    """Shade, ray length and number of the face that a ray meets, among the boxes seen."""
    t, box, axis = _nearest(world, start, ray, seen)
    if box < 0:
        return SKY, np.inf, -1
    to = _local(world, box, ray, 0.0)
    hit = _moved(_local(world, box, start, 1.0), to, t)
    sign = -1.0 if to[axis] > 0.0 else 1.0
    d_across = _slid(to, _local(world, box, across, 0.0), axis, t)
    d_down = _slid(to, _local(world, box, down, 0.0), axis, t)
    texel = _texture(world, box, axis, sign, hit, d_across, d_down, samples)
    face = axis * 2 + (1 if sign > 0.0 else 0)
    return texel * _light(world, box, face, hit), t, box * 6 + face


@_compiled
def _local(world: World, box: int, vector: _Vector, is_point: float) -> _Vector:
    """A point (1.0) or direction (0.0) of the world in the box's own frame."""
    x = vector[0] - is_point * world.centres[box, 0]
    y = vector[1] - is_point * world.centres[box, 1]
    z = vector[2] - is_point * world.centres[box, 2]
    cosine, sine = world.turns[box, 0], world.turns[box, 1]
    return cosine * x + sine * y, cosine * y - sine * x, z


@_compiled
def _slid(ray: _Vector, change: _Vector, axis: int, t: float) -> _Vector:
    """How the hit point moves on the face when the ray changes (Igehy 1999, eq. 10 to 12)."""
    share = change[axis] / ray[axis]
    return (
        t * (change[0] - share * ray[0]),
        t * (change[1] - share * ray[1]),
        t * (change[2] - share * ray[2]),
    )


@_compiled
def _enter(world: World, box: int, start: _Vector, ray: _Vector) -> tuple[float, int]:
    """Where a ray enters a box, and through which pair of faces; infinite for a miss."""
    o, d = _local(world, box, start, 1.0), _local(world, box, ray, 0.0)
    near, far, axis = -np.inf, np.inf, 0
    for k in range(3):
        half = world.halves[box, k]
        if d[k] == 0.0:
            if abs(o[k]) > half:
                return np.inf, 0
            continue
        middle, reach = -o[k] / d[k], half / abs(d[k])
        if middle - reach > near:
            near, axis = middle - reach, k
        far = min(far, middle + reach)
    return (near, axis) if 0.0 < near <= far else (np.inf, 0)


@_compiled
def _misses(bounds: Floats, node: int, start: _Vector, inverse: _Vector, limit: float) -> bool:
    near, far = 0.0, limit
    for k in range(3):
        first = (bounds[node, k] - start[k]) * inverse[k]
        second = (bounds[node, k + 3] - start[k]) * inverse[k]
        near, far = max(near, min(first, second)), min(far, max(first, second))
    return near > far


@_compiled
def _nearest(world: World, start: _Vector, ray: _Vector, seen: _Boxes) -> tuple[float, int, int]:
    """Ray length, box and axis of the first hit; box -1 for none."""
    boxes, starts = seen
    t, box, axis = np.inf, -1, 0
    for i in range(len(boxes)):
        if starts[i] >= t:
            break
        closer, face = _enter(world, boxes[i], start, ray)
        if closer < t:
            t, box, axis = closer, boxes[i], face
    return t, box, axis


@_compiled
def _light(world: World, box: int, face: int, hit: _Vector) -> float:
    """Baked light at a point of a face, bilinear."""
    lights, axis = world.lights, face // 2
    rows, columns = lights.sizes[box, face, 0], lights.sizes[box, face, 1]
    first, second = 1 if axis == 0 else 0, 1 if axis == 2 else 2
    right = (0.5 + 0.5 * hit[first] / world.halves[box, first]) * (columns - 1)
    up = (0.5 + 0.5 * hit[second] / world.halves[box, second]) * (rows - 1)
    j = min(max(int(right), 0), columns - 2)
    i = min(max(int(up), 0), rows - 2)
    fu, fv = right - j, up - i
    at = lights.offsets[box, face] + i * columns + j
    values = lights.values
    return float(
        (1.0 - fv) * ((1.0 - fu) * values[at] + fu * values[at + 1])
        + fv * ((1.0 - fu) * values[at + columns] + fu * values[at + columns + 1])
    )


@_compiled
def _on_face(axis: int, sign: float, local: _Vector) -> tuple[float, float]:
    """Right and down on a face as seen from outside, so that print reads the right way."""
    if axis == 0:
        return sign * local[1], -local[2]
    if axis == 1:
        return -sign * local[0], -local[2]
    return local[0], -sign * local[1]


@_compiled
def _texture(
    world: World,
    box: int,
    axis: int,
    sign: float,
    hit: _Vector,
    across: _Vector,
    down: _Vector,
    samples: int,
) -> float:
    """Texture averaged over a pixel's footprint."""
    texture = world.textures[box]
    su = sv = world.densities[box]
    if su == 0.0:
        length = world.halves[box, 1 if axis == 0 else 0]
        height = world.halves[box, 1 if axis == 2 else 2]
        su = world.atlas.widths[texture, 0] / (2.0 * length)
        sv = world.atlas.heights[texture, 0] / (2.0 * height)
    u, v = _on_face(axis, sign, hit)
    u = su * u + world.offsets[box, 0] + 0.5 * world.atlas.widths[texture, 0]
    v = sv * v + world.offsets[box, 1] + 0.5 * world.atlas.heights[texture, 0]
    au, av = _on_face(axis, sign, across)
    du, dv = _on_face(axis, sign, down)
    return _filtered(world, texture, u, v, (su * au, sv * av), (su * du, sv * dv), samples)


@_compiled
def _filtered(
    world: World,
    texture: int,
    u: float,
    v: float,
    first: tuple[float, float],
    second: tuple[float, float],
    samples: int,
) -> float:
    """Trilinear samples along the longer side of a footprint given by its two sides in texels."""
    long = np.sqrt(first[0] ** 2 + first[1] ** 2)
    short = np.sqrt(second[0] ** 2 + second[1] ** 2)
    along = first
    if short > long:
        long, short, along = short, long, second
    count = min(max(int(long / max(short, 1e-9) + 0.6), 1), samples)
    short = max(short, long / count)  # rather a little blur than aliasing
    level = min(max(np.log2(short), 0.0), LEVELS - 1.001)
    base = int(level)
    total = 0.0
    for i in range(count):
        shift = (i + 0.5) / count - 0.5
        su, sv = u + shift * along[0], v + shift * along[1]
        total += (1.0 - level + base) * _bilinear(world, texture, base, su, sv)
        if level > base:
            total += (level - base) * _bilinear(world, texture, base + 1, su, sv)
    return total / (255.0 * count)


@_compiled
def _bilinear(world: World, texture: int, level: int, u: float, v: float) -> float:
    atlas = world.atlas
    width, height = atlas.widths[texture, level], atlas.heights[texture, level]
    start = atlas.offsets[texture, level]
    shrink = 1.0 / (1 << level)
    u, v = u * shrink - 0.5, v * shrink - 0.5
    left, top = np.floor(u), np.floor(v)
    fu, fv = u - left, v - top
    j, i = int(left) & (width - 1), int(top) & (height - 1)
    j1, i1 = (j + 1) & (width - 1), (i + 1) & (height - 1)
    upper, lower = start + i * width, start + i1 * width
    texels = atlas.texels
    return float(
        (1.0 - fv) * ((1.0 - fu) * texels[upper + j] + fu * texels[upper + j1])
        + fv * ((1.0 - fu) * texels[lower + j] + fu * texels[lower + j1])
    )


@_compiled
def _blocks(world: World, box: int, start: _Vector, ray: _Vector) -> bool:
    """Whether a box is between start and start + ray, or start is inside it."""
    o, d = _local(world, box, start, 1.0), _local(world, box, ray, 0.0)
    near, far = 0.0, 1.0
    for k in range(3):
        half = world.halves[box, k]
        if d[k] == 0.0:
            if abs(o[k]) > half:
                return False
            continue
        middle, reach = -o[k] / d[k], half / abs(d[k])
        near, far = max(near, middle - reach), min(far, middle + reach)
    return near < far


@_compiled
def _blocker(world: World, start: _Vector, ray: _Vector, guess: int) -> int:
    """A box between start and start + ray, or -1; `guess` is the box to try first."""
    if _blocks(world, guess, start, ray):
        return guess
    inverse = (1.0 / ray[0], 1.0 / ray[1], 1.0 / ray[2])
    node = 0
    while node < len(world.node_skip):
        if _misses(world.node_bounds, node, start, inverse, 1.0):
            node = world.node_skip[node]
            continue
        leaf = world.node_box[node]
        if leaf >= 0 and _blocks(world, leaf, start, ray):
            return int(leaf)
        node += 1
    return -1


@_compiled
def _face_point(world: World, box: int, axis: int, sign: float, right: float, up: float) -> _Vector:
    """A point just above a face, from its shares 0…1 along the face's two own axes."""
    hx, hy, hz = world.halves[box, 0], world.halves[box, 1], world.halves[box, 2]
    lift = 1e-4  # else rounding lets a face shade itself
    if axis == 0:
        x, y, z = sign * (hx + lift), (2.0 * right - 1.0) * hy, (2.0 * up - 1.0) * hz
    elif axis == 1:
        x, y, z = (2.0 * right - 1.0) * hx, sign * (hy + lift), (2.0 * up - 1.0) * hz
    else:
        x, y, z = (2.0 * right - 1.0) * hx, (2.0 * up - 1.0) * hy, sign * (hz + lift)
    return _moved(
        _upright(world, box, (x, y, z)),
        (world.centres[box, 0], world.centres[box, 1], world.centres[box, 2]),
        1.0,
    )


@_compiled
def _upright(world: World, box: int, vector: _Vector) -> _Vector:
    """A direction of the box's own frame in the world."""
    cosine, sine = world.turns[box, 0], world.turns[box, 1]
    return (
        cosine * vector[0] - sine * vector[1],
        sine * vector[0] + cosine * vector[1],
        vector[2],
    )


@_compiled
def _outward(axis: int, sign: float, side: float, other: float, height: float) -> _Vector:
    """A direction of the box's own frame from its parts along and away from a face."""
    if axis == 0:
        return sign * height, side, other
    if axis == 1:
        return side, sign * height, other
    return side, other, sign * height


@_compiled
def _open_share(
    world: World, here: _Vector, axis: int, sign: float, box: int, to_sky: Floats
) -> float:
    """Share of the directions (K, 3) above a face that meet nothing within their length."""
    clear, guess = 0, box
    for k in range(len(to_sky)):
        local = _outward(axis, sign, to_sky[k, 0], to_sky[k, 1], to_sky[k, 2])
        blocker = _blocker(world, here, _upright(world, box, local), guess)
        clear += blocker < 0
        guess = blocker if blocker >= 0 else guess
    return clear / len(to_sky)


@_compiled
def _lamp_light(
    world: World,
    here: _Vector,
    axis: int,
    sign: float,
    box: int,
    lamps: Floats,
    reach_m: float,
) -> float:
    """Light from points (K, 3) of the lamp, each counted where it is in sight."""
    normal = _upright(world, box, _outward(axis, sign, 0.0, 0.0, 1.0))
    total, guess = 0.0, box
    for k in range(len(lamps)):
        to = (lamps[k, 0] - here[0], lamps[k, 1] - here[1], lamps[k, 2] - here[2])
        facing = normal[0] * to[0] + normal[1] * to[1] + normal[2] * to[2]
        if facing <= 0.0:
            continue
        blocker = _blocker(world, here, to, guess)
        if blocker >= 0:
            guess = blocker
            continue
        square = to[0] ** 2 + to[1] ** 2 + to[2] ** 2
        total += facing / np.sqrt(square) / (1.0 + square / reach_m**2)
    return total / len(lamps)
