"""A world of textured upright boxes, the light on them, and the tree that finds them by ray."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data_synth.scene.atlas import Atlas, pack
from data_synth.scene.solids import Solid
from vo.types import Floats, Floats32, Ints


class Lights(NamedTuple):
    """Light on a grid of points of each face.

    Attributes:
        values: (L,) float32, all faces row by row.
        offsets: (N, 6) where each face begins; face 2 * axis + (1 if outward is positive).
        sizes: (N, 6, 2) rows and columns, at least two each.
    """

    values: Floats32
    offsets: Ints
    sizes: Ints


class World(NamedTuple):
    """Boxes, their tree and their textures as plain arrays, ready for compiled code.

    Attributes:
        centres: (N, 3).
        halves: (N, 3) half sizes.
        turns: (N, 2) cosine and sine of yaw.
        textures: (N,) texture numbers.
        densities: (N,) texels per metre, 0 where the texture is fitted to each face.
        offsets: (N, 2) texels.
        node_bounds: (M, 6) lower then upper corners, nodes in depth-first order.
        node_skip: (M,) the next node if this one is missed.
        node_box: (M,) the box of a leaf, -1 for inner nodes.
        atlas: the textures.
        lights: the light on the faces.
    """

    centres: Floats
    halves: Floats
    turns: Floats
    textures: Ints
    densities: Floats
    offsets: Floats
    node_bounds: Floats
    node_skip: Ints
    node_box: Ints
    atlas: Atlas
    lights: Lights


def build_world(boxes: Sequence[Solid], textures: Sequence[Floats32]) -> World:
    """Turn boxes and textures into arrays and a bounding-volume tree; it is still dark."""
    centres = np.array([b.centre for b in boxes], dtype=np.float64)
    halves = np.array([b.size for b in boxes], dtype=np.float64) / 2.0
    yaws = np.array([b.yaw for b in boxes], dtype=np.float64)
    turns = np.column_stack([np.cos(yaws), np.sin(yaws)])
    bounds, skip, leaf = _tree(_bounds(centres, halves, turns))
    return World(
        centres=centres,
        halves=halves,
        turns=turns,
        textures=np.array([b.texture for b in boxes], dtype=np.int64),
        densities=np.array([b.density or 0.0 for b in boxes]),
        offsets=np.array([b.offset for b in boxes], dtype=np.float64),
        node_bounds=bounds,
        node_skip=skip,
        node_box=leaf,
        atlas=pack(textures),
        lights=_darkness(len(boxes)),
    )


def clearance(world: World, points: Floats) -> Floats:
    """Distance (N,) of points (N, 3) to the nearest box; 0 inside one."""
    relative = points[:, None] - world.centres
    cosine, sine = world.turns[:, 0], world.turns[:, 1]
    local = np.stack(
        [
            cosine * relative[..., 0] + sine * relative[..., 1],
            cosine * relative[..., 1] - sine * relative[..., 0],
            relative[..., 2],
        ],
        axis=-1,
    )
    outside = np.maximum(np.abs(local) - world.halves, 0.0)
    return np.asarray(np.linalg.norm(outside, axis=-1).min(axis=1))


def _darkness(boxes: int) -> Lights:
    offsets, sizes = np.zeros((boxes, 6), np.int64), np.full((boxes, 6, 2), 2, np.int64)
    return Lights(np.zeros(4, np.float32), offsets, sizes)


def _bounds(centres: Floats, halves: Floats, turns: Floats) -> Floats:
    cosine, sine = np.abs(turns[:, 0]), np.abs(turns[:, 1])
    reach = np.column_stack(
        [
            cosine * halves[:, 0] + sine * halves[:, 1],
            sine * halves[:, 0] + cosine * halves[:, 1],
            halves[:, 2],
        ]
    )
    return np.hstack([centres - reach, centres + reach])


def _tree(bounds: Floats) -> tuple[Floats, Ints, Ints]:
    """Nodes depth first with skip links: a ray walks them in order, without a stack."""
    nodes: list[Floats] = []
    skip: list[int] = []
    leaf: list[int] = []

    def add(members: Ints) -> None:
        here = len(nodes)
        lower, upper = bounds[members, :3].min(axis=0), bounds[members, 3:].max(axis=0)
        nodes.append(np.concatenate([lower, upper]))
        skip.append(-1)
        leaf.append(int(members[0]) if len(members) == 1 else -1)
        if len(members) > 1:
            for part in _split(bounds, members):
                add(part)
        skip[here] = len(nodes)

    add(np.arange(len(bounds)))
    return np.array(nodes), np.array(skip, dtype=np.int64), np.array(leaf, dtype=np.int64)


def _split(bounds: Floats, members: Ints) -> tuple[Ints, Ints]:
    """Split where surface times count is least (MacDonald and Booth 1990), on any axis."""
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
    """Half the surface of the bounds of the first 1, 2, … boxes."""
    lower = np.minimum.accumulate(bounds[:, :3])
    upper = np.maximum.accumulate(bounds[:, 3:])
    x, y, z = (upper - lower).T
    return np.asarray(x * y + y * z + z * x)
