"""Ray differentials: motion of the hit on a surface when the ray changes.

With a ray d and its change Δd, the hit moves by t (Δd - (n·Δd)/(n·d) d) on the tangent plane.

Source: Igehy, Tracing Ray Differentials, 1999, eq. 10 to 12.
"""

from __future__ import annotations

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import SIDE, Pair, Vector
from data_synth.scene.kernels.textures import face_coordinates, texture_follows_angle
from data_synth.scene.kernels.vectors import dot
from data_synth.scene.world import World


@inlined
def flat_differentials(
    axis: int, sign: float, ray: Vector, changes: tuple[Vector, Vector], t: float
) -> tuple[Pair, Pair]:
    """Motion of a hit on the flat face of an axis, right and down, for two changes of the ray."""
    facing = 1.0 / min(sign * ray[axis], -1e-9)
    along = face_coordinates(axis, sign, ray)
    first, second = (
        face_coordinates(axis, sign, changes[0]),
        face_coordinates(axis, sign, changes[1]),
    )
    p, q = sign * changes[0][axis] * facing, sign * changes[1][axis] * facing
    return (
        (t * (first[0] - p * along[0]), t * (first[1] - p * along[1])),
        (t * (second[0] - q * along[0]), t * (second[1] - q * along[1])),
    )


@inlined
def round_differentials(
    world: World,
    solid: int,
    part: int,
    axis: int,
    normal: Vector,
    hit: Vector,
    ray: Vector,
    changes: tuple[Vector, Vector],
    t: float,
) -> tuple[Pair, Pair]:
    """As `flat_differentials`, on the side of a cylinder or on a face of an ellipsoid's cube."""
    facing = inverse_cosine(normal, ray)
    first, second = (
        hit_differential(ray, changes[0], normal, t, facing),
        hit_differential(ray, changes[1], normal, t, facing),
    )
    if part == SIDE:
        direction = 1.0 if texture_follows_angle(world, solid, hit) else -1.0
        tangent = (-direction * normal[1], direction * normal[0], 0.0)
        return (dot(tangent, first), -first[2]), (dot(tangent, second), -second[2])
    sign = 1.0 if normal[axis] > 0.0 else -1.0
    return face_coordinates(axis, sign, first), face_coordinates(axis, sign, second)


@inlined
def hit_differential(
    ray: Vector, change: Vector, normal: Vector, t: float, facing: float
) -> Vector:
    """Motion of the hit for one change of the ray.

    `facing` is 1 / (n·d); the normal may have any length.
    """
    ratio = dot(normal, change) * facing
    return (
        t * (change[0] - ratio * ray[0]),
        t * (change[1] - ratio * ray[1]),
        t * (change[2] - ratio * ray[2]),
    )


@inlined
def inverse_cosine(normal: Vector, ray: Vector) -> float:
    """1 / (n·d), which is negative; limited for grazing rays."""
    return 1.0 / min(dot(normal, ray), -1e-9)
