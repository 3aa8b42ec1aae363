"""Intersection of a ray o + t d with one solid, in the frame of the solid.

Intersections with a shape are written with selections instead of branches, so that loops over the
rays of a packet become vector instructions.
"""

from __future__ import annotations

import math

import numpy as np

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.frames import load_shape, to_local, to_local_point
from data_synth.scene.kernels.records import BOX, ELLIPSOID, Pair, Shape, SlabHit, Vector, index
from data_synth.scene.world import World


@inlined
def intersect_solid(world: World, solid: int, start: Vector, ray: Vector) -> Pair:
    """Values of t where a ray enters and leaves a solid; entry > exit for a miss."""
    o, d = to_local_point(world, solid, start), to_local(world, solid, ray)
    kind, shape = world.kinds[index(solid)], load_shape(world, solid)
    if kind == BOX:
        near, far, _ = intersect_box(o, d, shape)
    elif kind == ELLIPSOID:
        near, far = intersect_ellipsoid(o, d, shape.inverse_x, shape.inverse_y, shape.inverse_z)
    else:
        near, far, _ = intersect_cylinder(o, d, shape)
    return near, far


@inlined
def intersect_box(o: Vector, d: Vector, shape: Shape) -> SlabHit:
    """Values of t where a ray enters and leaves a box, and the face of the entrance (slabs)."""
    hit = clip_to_slab((-np.inf, np.inf, 0.0), o[0], d[0], shape.half_x, 0.0)
    hit = clip_to_slab(hit, o[1], d[1], shape.half_y, 2.0)
    return clip_to_slab(hit, o[2], d[2], shape.half_z, 4.0)


@inlined
def intersect_cylinder(o: Vector, d: Vector, shape: Shape) -> SlabHit:
    """As `intersect_box`, of an upright cylinder; the face of its side is 0."""
    near, far, face = clip_to_slab((-np.inf, np.inf, 0.0), o[2], d[2], shape.half_z, 4.0)
    first, last = intersect_ellipsoid(o, d, shape.inverse_x, shape.inverse_y, 0.0)
    by_side = first > near
    return (first if by_side else near), min(far, last), (0.0 if by_side else face)


@inlined
def clip_to_slab(hit: SlabHit, o: float, d: float, reach: float, face: float) -> SlabHit:
    """Intersect an interval of t with a slab: -reach ≤ o + t d ≤ reach.

    The slab lies between `face`, whose outward normal is against the axis, and face + 1.
    """
    near, far, before = hit
    inverse = 1.0 / (d if d != 0.0 else 1e-300)
    middle, half = -o * inverse, reach * abs(inverse)  # t = middle ± half at the two planes
    later = middle - half > near
    entered = face if d > 0.0 else face + 1.0
    return (
        (middle - half if later else near),
        min(far, middle + half),
        (entered if later else before),
    )


@inlined
def intersect_ellipsoid(o: Vector, d: Vector, x: float, y: float, z: float) -> Pair:
    """Values of t where a ray enters and leaves the ellipsoid of half axes 1/x, 1/y, 1/z.

    Entry > exit for a miss. z = 0 gives an infinite upright cylinder. In coordinates scaled to the
    unit sphere, t = t_c ± sqrt((1 - |p|²) / |d|²), where p = o + t_c d is the point of the ray
    closest to the middle. The quadratic formula would lose all digits of small solids far away.
    """
    ox, oy, oz, dx, dy, dz = o[0] * x, o[1] * y, o[2] * z, d[0] * x, d[1] * y, d[2] * z
    a = dx * dx + dy * dy + dz * dz
    inverse = 1.0 / a
    middle = -(ox * dx + oy * dy + oz * dz) * inverse
    px, py, pz = ox + middle * dx, oy + middle * dy, oz + middle * dz
    rest = 1.0 - (px * px + py * py + pz * pz)
    reach = math.sqrt(max(rest, 0.0) * inverse)
    near = middle - reach if rest >= 0.0 else np.inf
    far = middle + reach if rest >= 0.0 else -np.inf
    # A ray along the axis of a cylinder is inside or outside all the way.
    inside = ox * ox + oy * oy <= 1.0
    if a == 0.0:
        near = -np.inf if inside else np.inf
        far = np.inf if inside else -np.inf
    return near, far
