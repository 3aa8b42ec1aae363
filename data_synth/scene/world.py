"""A world of textured solids, ground and light as arrays, for the compiled renderer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data_synth.scene.height_field import (
    STAIN_PER_TEXEL,
    HeightField,
    heights_at,
    make_height_field,
)
from data_synth.scene.solids import Ground, Kind, Solid
from vo.base.types import Bools, Bytes, Floats, Floats32, Ints


def soft_noise(side: int, slope: float, seed: int) -> Floats32:
    """Noise (side, side) with amplitude ~ 1/f^slope, about 0.5, in 0…1; periodic."""
    white = np.random.default_rng([seed, 50]).standard_normal((side, side), dtype=np.float32)
    fv, fu = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :]
    frequency = np.hypot(fv, fu)
    frequency[0, 0] = np.inf
    grains = np.fft.irfft2(np.fft.rfft2(white) * frequency**-slope, s=(side, side))
    return np.asarray(np.clip(0.5 + 0.2 * grains / grains.std(), 0.0, 1.0), dtype=np.float32)


LEVELS = 11


class Atlas(NamedTuple):
    """Mip-mapped textures; sides are powers of two, so that wrapping around is a bit mask."""

    texels: Bytes  # (T,) uint8, all levels of all textures row by row
    levels: Ints  # (N, LEVELS, 3) start, height and width of each level


def pack(textures: Sequence[Floats32]) -> Atlas:
    """Pack textures with LEVELS mip-maps each, every one the 2x2 mean of the one before."""
    parts: list[Bytes] = []
    levels = np.zeros((len(textures), LEVELS, 3), np.int64)
    total = 0
    for i, texture in enumerate(textures):
        level_image = texture
        for level in range(LEVELS):
            levels[i, level] = total, *level_image.shape
            parts.append(np.round(level_image * 255.0).astype(np.uint8).ravel())
            total += level_image.size
            level_image = _halved(level_image)
    return Atlas(np.concatenate(parts), levels)


def _halved(image: Floats32) -> Floats32:
    rows, columns = (2 if n > 1 else 1 for n in image.shape)
    shaped = image.reshape(image.shape[0] // rows, rows, image.shape[1] // columns, columns)
    return np.asarray(shaped.mean(axis=(1, 3)), dtype=np.float32)


class Tree(NamedTuple):
    """Nodes in depth-first order."""

    bounds: Floats  # (M, 6) lower then upper corners
    skip: Ints  # (M,) the next node if the ray misses this one
    solid: Ints  # (M,) the solid of a leaf, -1 for inner nodes


def build_tree(bounds: Floats) -> Tree:
    """Build the tree of solids with bounds (N, 6); traversal is in order, without a stack."""
    nodes: list[Floats] = []
    leaf: list[int] = []
    pending = [np.arange(len(bounds))] if len(bounds) else []
    while pending:
        members = pending.pop()
        lower, upper = bounds[members, :3].min(axis=0), bounds[members, 3:].max(axis=0)
        nodes.append(np.concatenate([lower, upper]))
        leaf.append(int(members[0]) if len(members) == 1 else -1)
        if len(members) > 1:
            pending.extend(reversed(_split(bounds, members)))
    skip = np.arange(1, len(nodes) + 1)
    for node in range(len(nodes) - 1, -1, -1):
        if leaf[node] < 0:
            skip[node] = skip[skip[node + 1]]  # behind its first child, then behind its second
    return Tree(np.array(nodes).reshape(-1, 6), skip, np.array(leaf, dtype=np.int64))


def _split(bounds: Floats, members: Ints) -> tuple[Ints, Ints]:
    """Split by the surface area heuristic (MacDonald and Booth 1990), along any axis."""
    best, halves = np.inf, (members[:1], members[1:])
    counts = np.arange(1, len(members))
    for axis in range(3):
        middles = bounds[members, axis] + bounds[members, axis + 3]
        order = members[np.argsort(middles, kind="stable")]
        before = _growing_areas(bounds[order])[:-1]
        after = _growing_areas(bounds[order[::-1]])[:-1][::-1]
        costs = before * counts + after * counts[::-1]
        at = int(np.argmin(costs))
        if costs[at] < best:
            best, halves = float(costs[at]), (order[: at + 1], order[at + 1 :])
    return halves


def _growing_areas(bounds: Floats) -> Floats:
    """Half the surface area of the bounds of the first 1, 2, … boxes."""
    lower = np.minimum.accumulate(bounds[:, :3])
    upper = np.maximum.accumulate(bounds[:, 3:])
    x, y, z = (upper - lower).T
    return np.asarray(x * y + y * z + z * x)


_STAIN_TEXELS_PER_M = 12.0
_STAIN_SIDE = 512
_STAIN_SLOPE = 1.3
_STAIN_SEED = 20
_CLEARANCE_STEP = 512


class Lights(NamedTuple):
    """Light on a grid of points of each face.

    The grids of a box are on its faces. Those of curved solids are on the cube about them, whose
    points are projected onto the surface, towards the middle or the axis of a cylinder.
    """

    values: Floats32  # (L,) float32, all faces, row by row
    # (N, 6, 3) start of each face, its rows and its columns, at least two each; face 2 * axis + (1
    # if the outward normal points along the axis)
    grids: Ints


class Sources(NamedTuple):
    """Sources of light."""

    sky: float  # radiance at the zenith
    sun: Floats  # (3,) unit vector towards the sun, or zeros
    sun_power: float  # radiance added to a surface that faces the sun
    ambient: float  # radiance of ambient light
    lamps: Floats  # (L, 5) centre, power and reach


class Movers(NamedTuple):
    """The moving solids: the last K of the world."""

    bodies: Ints  # (K,) number of the body of each
    places: Floats  # (K, 4) x, y, z and yaw of each in the frame of its body
    velocities: Floats  # (K, 3) metres per second
    lights: Floats  # (K, 4) direction times strength of the light on each, and ambient light


class World(NamedTuple):
    """Solids, their tree, textures and light as plain arrays, for compiled code."""

    kinds: Ints  # (N,) `Kind` of each solid
    shapes: Floats  # (N, 11) centre, half size, cosine and sine of yaw, inverse half size
    textures: Ints  # (N,) texture numbers
    scales: Floats  # (N, 3, 2) texels per metre, right and down, on the faces of each axis
    offsets: Floats  # (N, 2) texels
    # (N,) whether the texture runs round a cylinder, rather than half round and back
    goes_round: Bools
    stains: Floats  # (N, 2) strength, and texels of the stain per metre
    # (S, 6) lower and upper corners of boxes around the S <= N static solids, which come first
    bounds: Floats
    tree: Tree
    atlas: Atlas  # the textures; the last one is the stain
    lights: Lights
    sources: Sources
    height_field: HeightField
    movers: Movers


def build_world(
    solids: Sequence[Solid],
    textures: Sequence[Floats32],
    ground: Ground | None = None,
    movers: Sequence[tuple[int, Solid]] = (),
) -> World:
    """Turn solids and textures into arrays and a bounding-volume hierarchy, without light.

    `textures`: textures, to which solids and ground refer by number. `ground`: ground, if any.
    `movers`: moving solids, each with the number of its body and relative to the origin of the
    body, which is on the ground with x ahead. `with_bodies` places them.
    """
    everything = [*solids, *(solid for _, solid in movers)]
    shapes = np.array([_shape(s) for s in everything], dtype=np.float64).reshape(-1, 11)
    bounds = _bounds(shapes[: len(solids)])
    atlas = pack([*textures, soft_noise(_STAIN_SIDE, _STAIN_SLOPE, _STAIN_SEED)])
    densities = np.array([s.density or 0.0 for s in everything])
    stain_scales = np.where(densities > 0, STAIN_PER_TEXEL * densities, _STAIN_TEXELS_PER_M)
    return World(
        kinds=np.array([s.kind for s in everything], dtype=np.int64),
        shapes=shapes,
        textures=np.array([s.texture for s in everything], dtype=np.int64),
        scales=np.array([_scales(s, textures[s.texture].shape) for s in everything]).reshape(
            -1, 3, 2
        ),
        offsets=np.array([s.offset for s in everything], dtype=np.float64).reshape(-1, 2),
        goes_round=np.array(
            [s.density is None or _rounds(s, textures[s.texture].shape[1]) > 0 for s in everything],
            dtype=np.bool_,
        ),
        stains=np.column_stack([[s.stain for s in everything], stain_scales]),
        bounds=bounds,
        tree=build_tree(bounds),
        atlas=atlas,
        lights=_no_light(len(solids)),
        sources=Sources(0.8, np.zeros(3), 0.0, 0.0, np.zeros((0, 5))),
        height_field=make_height_field(ground),
        movers=_movers(movers),
    )


def clearance(world: World, points: Floats) -> Floats:
    """Distance (N,) of points (N, 3) to the box around the nearest static solid; 0 inside one.

    The height above the ground counts as the distance to it.
    """
    parts = [
        _clearance(world, points[k : k + _CLEARANCE_STEP])
        for k in range(0, len(points), _CLEARANCE_STEP)
    ]
    free = np.concatenate(parts) if parts else np.empty(0)
    if not world.height_field.exists:
        return free
    return np.maximum(np.minimum(free, points[:, 2] - heights_at(world.height_field, points)), 0.0)


def _clearance(world: World, points: Floats) -> Floats:
    shapes = np.ascontiguousarray(world.shapes[: len(world.bounds)].T)
    x, y, z = (points[:, axis, None] - shapes[axis] for axis in range(3))
    cosine, sine = shapes[6], shapes[7]
    squared = np.zeros_like(x)
    for apart, half in zip(
        (cosine * x + sine * y, cosine * y - sine * x, z), shapes[3:6], strict=True
    ):
        squared += np.maximum(np.abs(apart) - half, 0.0) ** 2
    return np.asarray(np.sqrt(squared.min(axis=1, initial=np.inf)))


def _bounds(shapes: Floats) -> Floats:
    """Lower and upper corners (N, 6) of upright boxes around solids."""
    halves, cosine, sine = shapes[:, 3:6], np.abs(shapes[:, 6]), np.abs(shapes[:, 7])
    reach = np.column_stack(
        [
            cosine * halves[:, 0] + sine * halves[:, 1],
            sine * halves[:, 0] + cosine * halves[:, 1],
            halves[:, 2],
        ]
    )
    return np.hstack([shapes[:, :3] - reach, shapes[:, :3] + reach])


def _shape(solid: Solid) -> list[float]:
    halves = [0.5 * side for side in solid.size]
    turn = float(np.cos(solid.yaw)), float(np.sin(solid.yaw))
    return [*solid.centre, *halves, *turn, *(1.0 / half for half in halves)]


def _rounds(solid: Solid, columns: int) -> int:
    """Repetitions of a texture round a cylinder; 0 if the cylinder is too thin."""
    if solid.kind != Kind.CYLINDER or solid.density is None:
        return 0
    return round(0.5 * np.pi * (solid.size[0] + solid.size[1]) * solid.density / columns)


def _scales(solid: Solid, texture: tuple[int, ...]) -> list[tuple[float, float]]:
    (x, y, z), (rows, columns) = solid.size, texture
    around = columns / (0.5 * np.pi * (x + y))
    if solid.density is not None:
        rounds = _rounds(solid, columns)
        across = rounds * around if rounds else solid.density
        return [(across, solid.density)] * 2 + [(solid.density, solid.density)]
    if solid.kind == Kind.CYLINDER:
        return [(around, rows / z)] * 2 + [(columns / x, rows / y)]
    return [(columns / y, rows / z), (columns / x, rows / z), (columns / x, rows / y)]


def _movers(movers: Sequence[tuple[int, Solid]]) -> Movers:
    places = np.array([[*s.centre, s.yaw] for _, s in movers], dtype=np.float64).reshape(-1, 4)
    bodies = np.array([body for body, _ in movers], dtype=np.int64)
    return Movers(bodies, places, np.zeros((len(movers), 3)), np.zeros((len(movers), 4)))


def _no_light(solids: int) -> Lights:
    grids = np.tile(np.array([0, 2, 2]), (solids, 6, 1))
    return Lights(np.zeros(4, np.float32), grids)
