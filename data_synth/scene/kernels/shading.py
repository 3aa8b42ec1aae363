"""Radiance of a hit: texture, stains and light."""

from __future__ import annotations

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.differentials import (
    flat_differentials,
    hit_differential,
    inverse_cosine,
    round_differentials,
)
from data_synth.scene.kernels.frames import (
    ground_number,
    outward_normal,
    part_of_face,
    to_local,
    to_local_point,
    undo_motion,
)
from data_synth.scene.kernels.ground import ground_normal
from data_synth.scene.kernels.lights import light_on_ground, light_on_solid
from data_synth.scene.kernels.records import ROUND, SIDE, SKY, Filter, Vector, index
from data_synth.scene.kernels.sky import sky_radiance
from data_synth.scene.kernels.texture_filter import NO_FILTER, footprint_filter
from data_synth.scene.kernels.textures import (
    cylinder_coordinates,
    face_coordinates,
    filtered_stain,
    sample_filtered,
    surface_texture,
)
from data_synth.scene.kernels.vectors import add_scaled, dominant_axis
from data_synth.scene.world import World


@inlined
def has_uniform_filter(world: World, number: int) -> bool:
    """Whether the filter changes little from pixel to pixel, as on flat faces."""
    if number < 0 or number == ground_number(world):
        return True
    return part_of_face(world, number // 6, number % 6) < ROUND


@inlined
def choose_filter(
    world: World,
    start: Vector,
    time: float,
    ray: Vector,
    sides: tuple[Vector, Vector],
    t: float,
    number: int,
) -> Filter:
    """Texture filter for a hit; `sides` are the changes of the ray along the footprint."""
    if number == SKY:
        return NO_FILTER
    if number == ground_number(world):
        return choose_ground_filter(world, add_scaled(start, ray, t), ray, sides, t)
    solid, face = number // 6, number % 6
    part = part_of_face(world, solid, face)
    local_ray = to_local(world, solid, ray)
    changes = to_local(world, solid, sides[0]), to_local(world, solid, sides[1])
    if part < ROUND:
        axis = part
        first, second = flat_differentials(axis, 2.0 * (face % 2) - 1.0, local_ray, changes, t)
    else:
        hit = add_scaled(
            to_local_point(world, solid, undo_motion(world, solid, start, time)), local_ray, t
        )
        normal = outward_normal(world, solid, part, face, hit)
        axis = 0 if part == SIDE else dominant_axis(normal)
        first, second = round_differentials(
            world, solid, part, axis, normal, hit, local_ray, changes, t
        )
    su, sv = world.scales[index(solid), index(axis), 0], world.scales[index(solid), index(axis), 1]
    scale = 0.0
    if world.stains[index(solid), 0] > 0.0:
        scale = world.stains[index(solid), 1]
    return footprint_filter(first, second, su, sv, scale)


@inlined
def surface_radiance(
    world: World,
    start: Vector,
    time: float,
    ray: Vector,
    t: float,
    number: int,
    filter_: Filter,
) -> float:
    """Radiance of a hit.

    `time` is that of the ray in seconds since the frame's stamp, for solids that move.
    """
    if number == SKY:
        return sky_radiance(world, ray)
    if number == ground_number(world):
        return ground_radiance(world, add_scaled(start, ray, t), filter_)
    solid, face = number // 6, number % 6
    part = part_of_face(world, solid, face)
    local_ray = to_local(world, solid, ray)
    hit = add_scaled(
        to_local_point(world, solid, undo_motion(world, solid, start, time)), local_ray, t
    )
    normal = outward_normal(world, solid, part, face, hit)
    if part < ROUND:
        axis = part
        at = face_coordinates(axis, 2.0 * (face % 2) - 1.0, hit)
    elif part == SIDE:
        axis = 0
        at = cylinder_coordinates(world, solid, hit)
    else:
        axis = dominant_axis(normal)
        at = face_coordinates(axis, 1.0 if normal[axis] > 0.0 else -1.0, hit)
    texture = surface_texture(world, solid, axis, part == SIDE, at, filter_)
    return texture * light_on_solid(world, solid, part, normal, hit)


@inlined
def choose_ground_filter(
    world: World, hit: Vector, ray: Vector, sides: tuple[Vector, Vector], t: float
) -> Filter:
    """Texture filter for a hit on the ground."""
    height_field = world.height_field
    normal = ground_normal(world, hit[0], hit[1])
    facing = inverse_cosine(normal, ray)
    a, d = (
        hit_differential(ray, sides[0], normal, t, facing),
        hit_differential(ray, sides[1], normal, t, facing),
    )
    k, scale = height_field.density, 0.0
    if height_field.stain > 0.0:
        scale = height_field.stain_scale
    return footprint_filter((a[0], a[1]), (d[0], d[1]), k, -k, scale)


@inlined
def ground_radiance(world: World, hit: Vector, filter_: Filter) -> float:
    """Radiance of the ground: its texture, projected from above, times stains and baked light."""
    height_field = world.height_field
    k = height_field.density
    value = sample_filtered(world, height_field.texture, k * hit[0], -k * hit[1], filter_)
    if height_field.stain > 0.0:
        k = height_field.stain_scale
        value *= 1.0 + 2.0 * height_field.stain * (
            filtered_stain(world, k * hit[0], -k * hit[1], filter_) - 0.5
        )
    return value * light_on_ground(world, hit[0], hit[1])
