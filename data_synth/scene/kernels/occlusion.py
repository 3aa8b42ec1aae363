"""Occlusion: whether a segment start…start + ray is blocked, and how much of the sky is visible.

Used for shadows of lamps and the sun, and for less ambient light in corners. Any solid that the
segment enters blocks it, so that the search ends at the first one found; the occluder of one ray is
tested first for the next one. The tree is traversed as in `culling`.
"""

from __future__ import annotations

import math

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.ground import intersect_ground
from data_synth.scene.kernels.records import GROUND, ZERO, Vector
from data_synth.scene.kernels.solids import intersect_solid
from data_synth.scene.kernels.vectors import add_scaled, reciprocal, tangent_basis
from data_synth.scene.world import World
from vo.base.types import Floats, Ints

_MAX_TESTED_SINGLY = 6  # nearby solids; for more, walking the tree is faster


@inlined
def ambient_visibility(
    world: World, point: Vector, normal: Vector, to_sky: Floats, nearby: Ints
) -> float:
    """Fraction of the directions (K, 3) above a surface that meet nothing within their length.

    Directions have coordinates along two tangents and the normal. Their density is proportional to
    the cosine of the angle to the normal, so that each counts equally. The solid that occluded the
    previous direction is tested first. `nearby` is room for a list of solids.
    """
    count = solids_within(world, point, ray_length(to_sky), nearby)
    first, second = tangent_basis(normal)
    has_ground = world.height_field.heights.shape[0] > 1
    visible, guess = 0, 0
    if count > _MAX_TESTED_SINGLY:
        guess = nearby[0]
    for k in range(len(to_sky)):
        ray = add_scaled(ZERO, first, to_sky[k, 0])
        ray = add_scaled(ray, second, to_sky[k, 1])
        ray = add_scaled(ray, normal, to_sky[k, 2])
        blocked = False
        if count > _MAX_TESTED_SINGLY:  # traverse the tree, the ground included
            occluder = find_occluder(world, point, ray, guess)
            visible += occluder < 0
            guess = occluder if occluder >= 0 else guess
            continue
        for other in range(count):
            solid = nearby[(guess + other) % count]
            if occludes(world, solid, point, ray):
                guess, blocked = (guess + other) % count, True
                break
        if not blocked and has_ground:
            blocked = intersect_ground(world, point, ray, 0.0, 1.0) < 1.0
        visible += not blocked
    return visible / len(to_sky)


@inlined
def ray_length(to_sky: Floats) -> float:
    """Length of the directions, which is that of the first."""
    return math.sqrt(to_sky[0, 0] ** 2 + to_sky[0, 1] ** 2 + to_sky[0, 2] ** 2)


@inlined
def solids_within(world: World, point: Vector, reach: float, nearby: Ints) -> int:
    """List the solids whose boxes come within a distance of a point; returns their number."""
    tree = world.tree
    b = tree.bounds
    node, count = 0, 0
    while node < len(tree.skip):
        if (
            b[node, 0] > point[0] + reach
            or b[node, 1] > point[1] + reach
            or b[node, 2] > point[2] + reach
            or b[node, 3] < point[0] - reach
            or b[node, 4] < point[1] - reach
            or b[node, 5] < point[2] - reach
        ):
            node = tree.skip[node]
            continue
        if tree.solid[node] >= 0:
            nearby[count] = tree.solid[node]
            count += 1
        node += 1
    return count


@inlined
def find_occluder(world: World, start: Vector, ray: Vector, guess: int) -> int:
    """A solid, or GROUND, between start and start + ray; -1 for none. `guess` is tested first."""
    if guess != GROUND and occludes(world, guess, start, ray):
        return guess
    inverse = (reciprocal(ray[0]), reciprocal(ray[1]), reciprocal(ray[2]))
    tree = world.tree
    node = 0
    while node < len(tree.skip):
        if misses_box(tree.bounds, node, start, inverse):
            node = tree.skip[node]
            continue
        leaf = tree.solid[node]
        if leaf >= 0 and occludes(world, leaf, start, ray):
            return int(leaf)
        node += 1
    if (
        world.height_field.heights.shape[0] > 1
        and intersect_ground(world, start, ray, 0.0, 1.0) < 1.0
    ):
        return GROUND
    return -1


@inlined
def occludes(world: World, solid: int, start: Vector, ray: Vector) -> bool:
    """Whether a solid is between start and start + ray, or contains start."""
    near, far = intersect_solid(world, solid, start, ray)
    return max(near, 0.0) < min(far, 1.0)


@inlined
def misses_box(bounds: Floats, node: int, start: Vector, inverse: Vector) -> bool:
    """Whether start…start + ray misses the box of a node (slab method); `inverse` is 1 / ray."""
    near, far = 0.0, 1.0
    for k in range(3):
        first = (bounds[node, k] - start[k]) * inverse[k]
        second = (bounds[node, k + 3] - start[k]) * inverse[k]
        near, far = max(near, min(first, second)), min(far, max(first, second))
    return near > far
