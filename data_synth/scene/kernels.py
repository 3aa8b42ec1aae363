"""Compiled kernels: which surface a ray meets, its filtered texture, and the light on it.

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
from data_synth.scene.solids import Kind
from data_synth.scene.world import World
from vo.types import Floats, Floats32, Ints

TILE = 16
_MAX_ANISOTROPY = 8
_EDGE_GRID = 3
_FAR_M = 1000.0
_DARKEST = 0.35  # ambient light in the deepest corner

_BOX, _ELLIPSOID = int(Kind.BOX), int(Kind.ELLIPSOID)
_ROUND, _SIDE = 3, 4  # parts of solids: 0, 1, 2 are flat faces across an axis
_SKY = -1
_CLOUDS_PER_TURN = 90.0

_F = TypeVar("_F", bound=Callable[..., Any])
_Vector = tuple[float, float, float]
_Pair = tuple[float, float]
_List = tuple[Ints, Floats]  # solids, and ray lengths below which each cannot be met
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


# --- Views -----------------------------------------------------------------------------------


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
    solids, starts = _empty_list(world)
    for top in range(band[0], band[1], TILE):
        bottom = min(top + TILE, band[1])
        for left in range(0, rays.shape[1], TILE):
            right = min(left + TILE, rays.shape[1])
            count = _list_solids(
                world, start, rays, rotation, (top, bottom, left, right), solids, starts
            )
            seen = (solids[:count], starts[:count])
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
    solids, starts = _empty_list(world)
    for top in range(band[0], band[1], TILE):
        bottom = min(top + TILE, band[1])
        for left in range(0, rays.shape[1], TILE):
            right = min(left + TILE, rays.shape[1])
            count = _list_solids(
                world, start, rays, rotation, (top, bottom, left, right), solids, starts
            )
            seen = (solids[:count], starts[:count])
            for row in range(top, bottom):
                for column in range(left, right):
                    if _is_edge(surface, row, column):
                        ray, across, down = _ray(rays, row, column, rotation)
                        image[row, column] = _mean_radiance(world, start, ray, across, down, seen)


@_compiled
def _mean_radiance(
    world: World, start: _Vector, ray: _Vector, across: _Vector, down: _Vector, seen: _List
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


# --- Which solids a tile may see -------------------------------------------------------------


@_entry
def _empty_list(world: World) -> _List:
    return np.empty(len(world.kinds), np.int64), np.empty(len(world.kinds))


@_compiled
def _list_solids(
    world: World,
    start: _Vector,
    rays: Floats,
    rotation: Floats,
    tile: tuple[int, int, int, int],
    solids: Ints,
    starts: Floats,
) -> int:
    """List the solids that any ray of a tile may meet, by the shortest length at which it may."""
    low, high = _ray_range(rays, rotation, tile)
    tree = world.tree
    node, count = 0, 0
    while node < len(tree.skip):
        b = tree.bounds[node]
        near = _earliest((b[0], b[1], b[2]), (b[3], b[4], b[5]), start, low, high)
        if near == np.inf:
            node = tree.skip[node]
            continue
        if tree.solid[node] >= 0:
            count = _insert(solids, starts, count, tree.solid[node], near)
        node += 1
    moving = len(world.movers.bodies)
    for solid in range(len(world.kinds) - moving, len(world.kinds)):
        lower, upper = _bounds(world, solid)
        near = _earliest(lower, upper, start, low, high)
        if near != np.inf:
            count = _insert(solids, starts, count, solid, near)
    return count


@_compiled
def _insert(solids: Ints, starts: Floats, count: int, solid: int, near: float) -> int:
    at = count
    while at > 0 and starts[at - 1] > near:
        solids[at], starts[at] = solids[at - 1], starts[at - 1]
        at -= 1
    solids[at], starts[at] = solid, near
    return count + 1


@_compiled
def _bounds(world: World, solid: int) -> tuple[_Vector, _Vector]:
    """Corners of an upright box in the world's frame around a solid."""
    shape = world.shapes[solid]
    cosine, sine = abs(shape[6]), abs(shape[7])
    x, y, z = cosine * shape[3] + sine * shape[4], sine * shape[3] + cosine * shape[4], shape[5]
    return (
        (shape[0] - x, shape[1] - y, shape[2] - z),
        (shape[0] + x, shape[1] + y, shape[2] + z),
    )


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
def _earliest(lower: _Vector, upper: _Vector, start: _Vector, low: _Vector, high: _Vector) -> float:
    """Lower bound of the length at which rays between low and high meet a box; or infinite."""
    near, far = 0.0, np.inf
    for k in range(3):
        first, last = lower[k] - start[k], upper[k] - start[k]
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


# --- What one ray meets ----------------------------------------------------------------------


@_compiled
def _radiance(
    world: World,
    start: _Vector,
    ray: _Vector,
    across: _Vector,
    down: _Vector,
    seen: _List,
    samples: int,
) -> tuple[float, float, int]:
    """Shade, ray length and number of the face that a ray meets, among the solids seen."""
    t, solid, part = _nearest(world, start, ray, seen)
    if solid < 0:
        return _sky(world, ray), np.inf, _SKY
    to = _local(world, solid, ray)
    hit = _moved(_local_point(world, solid, start), to, t)
    normal = _normal(world, solid, part, hit, to)
    change = (
        _slid(to, _local(world, solid, across), normal, t),
        _slid(to, _local(world, solid, down), normal, t),
    )
    shade = _texture(world, solid, part, normal, hit, change[0], change[1], samples)
    number = solid * 6
    if part < _ROUND:
        number += _face_of(part, normal)
    return shade * _light(world, solid, part, normal, hit), t, number


@_compiled
def _nearest(world: World, start: _Vector, ray: _Vector, seen: _List) -> tuple[float, int, int]:
    """Ray length, solid and part of the first hit; solid -1 for none."""
    solids, starts = seen
    t, solid, part = np.inf, -1, 0
    for i in range(len(solids)):
        if starts[i] >= t:
            break
        closer, there = _enter(world, solids[i], start, ray)
        if closer < t:
            t, solid, part = closer, solids[i], there
    return t, solid, part


@_compiled
def _enter(world: World, solid: int, start: _Vector, ray: _Vector) -> tuple[float, int]:
    """Where a ray enters a solid, and through which part of it; infinite for a miss."""
    near, far, part = _span(world, solid, start, ray)
    return (near, part) if 0.0 < near <= far else (np.inf, 0)


@_compiled
def _span(world: World, solid: int, start: _Vector, ray: _Vector) -> tuple[float, float, int]:
    """Ray lengths at which a ray enters and leaves a solid, and through which part it enters."""
    o, d = _local_point(world, solid, start), _local(world, solid, ray)
    kind, shape = world.kinds[solid], world.shapes[solid]
    near, far, part = -np.inf, np.inf, 0
    if kind != _ELLIPSOID:
        for k in range(0 if kind == _BOX else 2, 3):
            inverse = 1.0 / (d[k] if d[k] != 0.0 else 1e-300)
            middle, reach = -o[k] * inverse, shape[3 + k] * abs(inverse)
            if middle - reach > near:
                near, part = middle - reach, k
            far = min(far, middle + reach)
    if kind != _BOX:
        height = 1.0 / shape[5] if kind == _ELLIPSOID else 0.0
        first, last = _round_span(o, d, 1.0 / shape[3], 1.0 / shape[4], height)
        if first > near:
            near, part = first, _ROUND if kind == _ELLIPSOID else _SIDE
        far = min(far, last)
    return near, far, part


@_compiled
def _round_span(o: _Vector, d: _Vector, x: float, y: float, z: float) -> _Pair:
    """Where a ray is within the ellipsoid of half axes 1/x, 1/y, 1/z; empty for a miss."""
    ox, oy, oz, dx, dy, dz = o[0] * x, o[1] * y, o[2] * z, d[0] * x, d[1] * y, d[2] * z
    a = dx * dx + dy * dy + dz * dz
    if a == 0.0:  # along a cylinder
        return (-np.inf, np.inf) if ox * ox + oy * oy <= 1.0 else (np.inf, -np.inf)
    middle = -(ox * dx + oy * dy + oz * dz) / a
    # From the point of the ray closest to the middle: exact also for small things far away.
    px, py, pz = ox + middle * dx, oy + middle * dy, oz + middle * dz
    rest = 1.0 - (px * px + py * py + pz * pz)
    if rest < 0.0:
        return np.inf, -np.inf
    reach = np.sqrt(rest / a)
    return middle - reach, middle + reach


@_compiled
def _normal(world: World, solid: int, part: int, hit: _Vector, ray: _Vector) -> _Vector:
    """Outward unit normal where a ray enters, in the solid's own frame."""
    if part < _ROUND:
        sign = -1.0 if ray[part] > 0.0 else 1.0
        return _along(part, sign)
    shape = world.shapes[solid]
    x, y = hit[0] / (shape[3] * shape[3]), hit[1] / (shape[4] * shape[4])
    z = hit[2] / (shape[5] * shape[5]) if part == _ROUND else 0.0
    scale = 1.0 / np.sqrt(x * x + y * y + z * z)
    return scale * x, scale * y, scale * z


@_compiled
def _slid(ray: _Vector, change: _Vector, normal: _Vector, t: float) -> _Vector:
    """How the hit point moves on the surface when the ray changes (Igehy 1999, eq. 10 to 12)."""
    facing = _dot(normal, ray)
    share = _dot(normal, change) / min(facing, -1e-9)
    return (
        t * (change[0] - share * ray[0]),
        t * (change[1] - share * ray[1]),
        t * (change[2] - share * ray[2]),
    )


@_compiled
def _sky(world: World, ray: _Vector) -> float:
    """Radiance of the sky: paler at the horizon, with soft clouds."""
    flat = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    slope = ray[2] / max(flat, 1e-9)
    radiance = world.sky.radiance
    pale = 0.3 + 0.7 * radiance
    if slope <= 0.0:
        return pale
    rise = slope / np.sqrt(1.0 + slope * slope)
    mist = (1.0 - rise) ** 4
    spread = _CLOUDS_PER_TURN / (ray[2] + 0.25 * flat)
    stain = len(world.atlas.widths) - 1
    value = _bilinear(world, stain, 2, spread * ray[0], spread * ray[1]) / 255.0
    cloud = min(max(2.5 * (value - 0.5), 0.0), 1.0)
    clear = radiance + (0.97 - radiance) * cloud
    return clear + (pale - clear) * mist


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
def _turned(rotation: Floats, x: float, y: float, z: float) -> _Vector:
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@_compiled
def _local_point(world: World, solid: int, point: _Vector) -> _Vector:
    """A point of the world in the solid's own frame."""
    shape = world.shapes[solid]
    return _local(world, solid, (point[0] - shape[0], point[1] - shape[1], point[2] - shape[2]))


@_compiled
def _local(world: World, solid: int, vector: _Vector) -> _Vector:
    """A direction of the world in the solid's own frame."""
    cosine, sine = world.shapes[solid, 6], world.shapes[solid, 7]
    return (
        cosine * vector[0] + sine * vector[1],
        cosine * vector[1] - sine * vector[0],
        vector[2],
    )


@_compiled
def _upright(world: World, solid: int, vector: _Vector) -> _Vector:
    """A direction of the solid's own frame in the world."""
    cosine, sine = world.shapes[solid, 6], world.shapes[solid, 7]
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
    world: World,
    solid: int,
    part: int,
    normal: _Vector,
    hit: _Vector,
    across: _Vector,
    down: _Vector,
    samples: int,
) -> float:
    """Texture averaged over a pixel's footprint, given by its two sides on the surface."""
    if part == _SIDE:
        axis = 0
        right, low, turn = _unrolled(world, solid, hit)
        tangent = (-turn * normal[1], turn * normal[0], 0.0)
        a, d = (_dot(tangent, across), -across[2]), (_dot(tangent, down), -down[2])
    else:
        axis = _longest(normal) if part == _ROUND else part
        sign = 1.0 if normal[axis] > 0.0 else -1.0
        right, low = _on_face(axis, sign, hit)
        a, d = _on_face(axis, sign, across), _on_face(axis, sign, down)
    su, sv = world.scales[solid, axis, 0], world.scales[solid, axis, 1]
    texture = world.textures[solid]
    u = su * right + world.offsets[solid, 0] + 0.5 * world.atlas.widths[texture, 0]
    v = sv * low + world.offsets[solid, 1] + 0.5 * world.atlas.heights[texture, 0]
    value = _filtered(world, texture, u, v, (su * a[0], sv * a[1]), (su * d[0], sv * d[1]), samples)
    if world.stains[solid, 0] > 0.0:
        scale = world.stains[solid, 1]
        size = scale * max(abs(a[0]) + abs(d[0]), abs(a[1]) + abs(d[1]))
        shift = 57.3 * solid  # so that no two solids have the same stains
        stain = _stain(world, scale * right + shift, scale * low + 0.7 * shift, size)
        value *= 1.0 + 2.0 * world.stains[solid, 0] * (stain - 0.5)
    return value


@_compiled
def _unrolled(world: World, solid: int, hit: _Vector) -> tuple[float, float, float]:
    """Right and down on a cylinder's side, and whether the texture runs with the angle there.

    A texture that is not fitted runs half around and back, so that it has no seam.
    """
    shape = world.shapes[solid]
    angle = np.arctan2(hit[1] / shape[4], hit[0] / shape[3])
    radius = 0.5 * (shape[3] + shape[4])
    if world.fitted[solid] or angle >= 0.0:
        return radius * angle, -hit[2], 1.0
    return -radius * angle, -hit[2], -1.0


@_compiled
def _on_face(axis: int, sign: float, local: _Vector) -> _Pair:
    """Right and down on a face as seen from outside, so that print reads the right way."""
    if axis == 0:
        return sign * local[1], -local[2]
    if axis == 1:
        return -sign * local[0], -local[2]
    return local[0], -sign * local[1]


@_compiled
def _stain(world: World, u: float, v: float, size: float) -> float:
    """The stain, 0…1, blurred to a footprint of `size` texels."""
    texture = len(world.atlas.widths) - 1
    level = min(max(np.log2(max(size, 1e-9)), 0.0), LEVELS - 1.001)
    base = int(level)
    value = (1.0 - level + base) * _bilinear(world, texture, base, u, v)
    if level > base:
        value += (level - base) * _bilinear(world, texture, base + 1, u, v)
    return value / 255.0


@_compiled
def _filtered(
    world: World,
    texture: int,
    u: float,
    v: float,
    first: _Pair,
    second: _Pair,
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


# --- Light on surfaces -----------------------------------------------------------------------


@_compiled
def _light(world: World, solid: int, part: int, normal: _Vector, hit: _Vector) -> float:
    """Light at a point of a solid: baked, bilinear; or simple on what moves."""
    mover = solid - (len(world.kinds) - len(world.movers.bodies))
    if mover >= 0:
        return _simple_light(world, mover, _upright(world, solid, normal))
    shape = world.shapes[solid]
    p = (hit[0] / shape[3], hit[1] / shape[4], hit[2] / shape[5])
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
    lights = world.lights
    rows, columns = lights.sizes[solid, face, 0], lights.sizes[solid, face, 1]
    right, up = (0.5 + 0.5 * right) * (columns - 1), (0.5 + 0.5 * up) * (rows - 1)
    j = min(max(int(right), 0), columns - 2)
    i = min(max(int(up), 0), rows - 2)
    fu, fv = right - j, up - i
    at = lights.offsets[solid, face] + i * columns + j
    values = lights.values
    return float(
        (1.0 - fv) * ((1.0 - fu) * values[at] + fu * values[at + 1])
        + fv * ((1.0 - fu) * values[at + columns] + fu * values[at + columns + 1])
    )


@_compiled
def _simple_light(world: World, mover: int, normal: _Vector) -> float:
    """Light on a solid that moves: from above, and half of it from all around."""
    light = world.movers.lights[mover]
    facing = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    return max(facing, 0.0) + light[3] * (0.8 + 0.2 * normal[2])


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
    lights = world.lights
    for number in range(faces[0], faces[1]):
        solid, face = number // 6, number % 6
        rows, columns = lights.sizes[solid, face, 0], lights.sizes[solid, face, 1]
        for i in range(rows):
            for j in range(columns):
                right, up = 2.0 * j / (columns - 1) - 1.0, 2.0 * i / (rows - 1) - 1.0
                point, normal = _surface_point(world, solid, face, right, up)
                tint = _tint(normal)
                here = _moved(point, normal, 1e-4)  # else rounding lets a face shade itself
                shape = world.shapes[solid]
                here = _moved(_upright(world, solid, here), (shape[0], shape[1], shape[2]), 1.0)
                outward = _upright(world, solid, normal)
                lights.values[lights.offsets[solid, face] + i * columns + j] = _all_light(
                    world, here, outward, tint, solid, lamps, lamp_points, to_sky
                )


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
) -> float:
    """Light at a point from all around, from the sun and from lamps."""
    open_share = _open_share(world, here, normal, guess, to_sky)
    total = world.sky.ambient * tint * (_DARKEST + (1.0 - _DARKEST) * open_share)
    sun = (world.sky.sun[0], world.sky.sun[1], world.sky.sun[2])
    facing = _dot(normal, sun)
    if facing > 0.0 and _blocker(world, here, _moved(_ZERO, sun, _FAR_M), guess) < 0:
        total += world.sky.sun_power * facing
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
        normal = _normal(world, solid, _ROUND, hit, _ZERO)
    elif kind != _BOX and axis < 2:
        normal = _normal(world, solid, _SIDE, hit, _ZERO)
    return hit, normal


@_compiled
def _open_share(world: World, here: _Vector, normal: _Vector, guess: int, to_sky: Floats) -> float:
    """Share of the directions (K, 3) above a surface that meet nothing within their length."""
    first, second = _tangents(normal)
    clear = 0
    for k in range(len(to_sky)):
        ray = _moved(_ZERO, first, to_sky[k, 0])
        ray = _moved(ray, second, to_sky[k, 1])
        ray = _moved(ray, normal, to_sky[k, 2])
        blocker = _blocker(world, here, ray, guess)
        clear += blocker < 0
        guess = blocker if blocker >= 0 else guess
    return clear / len(to_sky)


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
            return lamp[3] * total / 4.0
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
    return lamp[3] * total / len(points)


@_compiled
def _blocker(world: World, start: _Vector, ray: _Vector, guess: int) -> int:
    """A solid between start and start + ray, or -1; `guess` is the one to try first."""
    if _blocks(world, guess, start, ray):
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
    return -1


@_compiled
def _blocks(world: World, solid: int, start: _Vector, ray: _Vector) -> bool:
    """Whether a solid is between start and start + ray, or start is inside it."""
    near, far, _ = _span(world, solid, start, ray)
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
