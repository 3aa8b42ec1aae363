"""Frames, parts and normals of solids.

The frame of a solid has its origin in the middle and its axes along the sides.
"""

from __future__ import annotations

import math

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import BOX, ELLIPSOID, ROUND, SIDE, ZERO, Shape, Vector, index
from data_synth.scene.kernels.vectors import add_scaled, axis_vector
from data_synth.scene.world import World


@inlined
def ground_number(world: World) -> int:
    """Number of the surface of the ground."""
    return 6 * len(world.kinds)


@inlined
def part_of_face(world: World, solid: int, face: int) -> int:
    """The part of a solid that has a face: the axis of a flat one, ROUND or SIDE."""
    kind = world.kinds[index(solid)]
    if kind == BOX:
        return face // 2
    if kind == ELLIPSOID:
        return ROUND
    return 2 if face >= 4 else SIDE


@inlined
def cube_face(axis: int, vector: Vector) -> int:
    """The face of a cube about the origin towards which a vector points; `axis` is its longest."""
    return 2 * axis + (1 if vector[axis] > 0.0 else 0)


@inlined
def load_shape(world: World, solid: int) -> Shape:
    """A row of `World.shapes` as scalars."""
    s = world.shapes[index(solid)]
    return Shape(s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9], s[10])


@inlined
def velocity_of(world: World, solid: int) -> Vector:
    """Velocity of a solid in m/s; zero unless it is one of the movers."""
    mover = solid - len(world.bounds)
    if mover < 0:
        return ZERO
    velocity = world.movers.velocities[mover]
    return velocity[0], velocity[1], velocity[2]


@inlined
def undo_motion(world: World, solid: int, start: Vector, time: float) -> Vector:
    """A point at a time, relative to a moving solid as it stands at the frame's stamp."""
    mover = solid - len(world.bounds)
    if mover < 0:
        return start
    velocity = world.movers.velocities[mover]
    return add_scaled(start, (velocity[0], velocity[1], velocity[2]), -time)


@inlined
def to_local_point(world: World, solid: int, point: Vector) -> Vector:
    """A point of the world in the frame of a solid."""
    shape = world.shapes[index(solid)]
    return to_local(world, solid, (point[0] - shape[0], point[1] - shape[1], point[2] - shape[2]))


@inlined
def to_local(world: World, solid: int, vector: Vector) -> Vector:
    """A direction of the world in the frame of a solid."""
    cosine, sine = world.shapes[index(solid), 6], world.shapes[index(solid), 7]
    return (
        cosine * vector[0] + sine * vector[1],
        cosine * vector[1] - sine * vector[0],
        vector[2],
    )


@inlined
def to_world(world: World, solid: int, vector: Vector) -> Vector:
    """A direction in the frame of a solid in the world."""
    cosine, sine = world.shapes[index(solid), 6], world.shapes[index(solid), 7]
    return (
        cosine * vector[0] - sine * vector[1],
        sine * vector[0] + cosine * vector[1],
        vector[2],
    )


@inlined
def outward_normal(world: World, solid: int, part: int, face: int, hit: Vector) -> Vector:
    """Outward unit normal at a point of a face, in the frame of the solid.

    Of an ellipsoid x²/a² + y²/b² + z²/c² = 1 along its gradient (x/a², y/b², z/c²); of a cylinder
    without z.
    """
    if part < ROUND:
        return axis_vector(part, 2.0 * (face % 2) - 1.0)
    shape = world.shapes[index(solid)]
    x, y = hit[0] * shape[8] * shape[8], hit[1] * shape[9] * shape[9]
    z = hit[2] * shape[10] * shape[10] if part == ROUND else 0.0
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return scale * x, scale * y, scale * z
