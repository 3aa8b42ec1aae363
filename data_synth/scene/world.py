"""A world of textured solids, ground and light as arrays, for the compiled renderer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data_synth.scene.atlas import Atlas, pack
from data_synth.scene.height_field import (
    STAIN_PER_TEXEL,
    HeightField,
    heights_at,
    make_height_field,
)
from data_synth.scene.noise import soft_noise
from data_synth.scene.solids import Ground, Kind, Solid
from data_synth.scene.tree import Tree, build_tree
from vo.base.types import Bools, Floats, Floats32, Ints

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
    shapes = world.shapes[: len(world.bounds)]
    relative = points[:, None] - shapes[:, :3]
    cosine, sine = shapes[:, 6], shapes[:, 7]
    local = np.stack(
        [
            cosine * relative[..., 0] + sine * relative[..., 1],
            cosine * relative[..., 1] - sine * relative[..., 0],
            relative[..., 2],
        ],
        axis=-1,
    )
    outside = np.maximum(np.abs(local) - shapes[:, 3:6], 0.0)
    return np.asarray(np.linalg.norm(outside, axis=-1).min(axis=1, initial=np.inf))


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
