"""Radiance of a hit: texture, stains and light."""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.differentials import (
    flat_differentials,
    hit_differential,
    inverse_cosine,
    round_differentials,
)
from data_synth.scene.kernels.frames import (
    cube_face,
    ground_number,
    outward_normal,
    part_of_face,
    to_local,
    to_local_point,
    to_world,
    undo_motion,
)
from data_synth.scene.kernels.ground import grid_position, ground_normal, interpolate
from data_synth.scene.kernels.records import ROUND, SIDE, SKY, ZERO, Filter, Vector, index
from data_synth.scene.kernels.textures import (
    NO_FILTER,
    cylinder_coordinates,
    face_coordinates,
    filtered_stain,
    footprint_filter,
    sample_filtered,
    sample_stain,
    surface_texture,
)
from data_synth.scene.kernels.vectors import add_scaled, dominant_axis
from data_synth.scene.world import World

_CLOUD_TEXELS = 22.5  # of level 2 of the stain, per unit of slope overhead


@inlined
def sky_radiance(world: World, ray: Vector) -> float:
    """Radiance of the sky along a ray: paler at the horizon, with soft clouds.

    Clouds are the stain texture, projected onto a plane above and bent down to the horizon.
    """
    flat = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    slope = ray[2] / max(flat, 1e-9)
    radiance = world.sources.sky
    pale = 0.3 + 0.7 * radiance
    if slope <= 0.0:
        return pale
    # rise is the sine of the elevation; (1 - rise)^4 is 1 at the horizon and soon negligible.
    rise = slope / np.sqrt(1.0 + slope * slope)
    mist = (1.0 - rise) ** 4
    spread = _CLOUD_TEXELS / (ray[2] + 0.25 * flat)
    value = sample_stain(world, 2, spread * ray[0], spread * ray[1])
    cloud = min(max(2.5 * (value - 0.5), 0.0), 1.0)
    clear = radiance + (0.97 - radiance) * cloud
    return float(clear + (pale - clear) * mist)


@inlined
def light_on_solid(world: World, solid: int, part: int, normal: Vector, hit: Vector) -> float:
    """Light at a point of a solid: bilinear from the baked grids, or that of a mover.

    Curved surfaces are projected onto the cube about them, from the middle or the axis.
    """
    mover = solid - len(world.bounds)
    if mover >= 0:
        return light_on_mover(world, mover, to_world(world, solid, normal))
    shape = world.shapes[index(solid)]
    p = (hit[0] * shape[8], hit[1] * shape[9], hit[2] * shape[10])
    axis = part
    if part == SIDE:
        axis = dominant_axis((p[0], p[1], 0.0))
        scale = 1.0 / abs(p[axis])
        p = (p[0] * scale, p[1] * scale, p[2])
    elif part == ROUND:
        axis = dominant_axis(p)
        p = add_scaled(ZERO, p, 1.0 / abs(p[axis]))
    first, second = 1 if axis == 0 else 0, 1 if axis == 2 else 2
    return baked_light(world, solid, cube_face(axis, p), p[first], p[second])


@inlined
def baked_light(world: World, solid: int, face: int, right: float, up: float) -> float:
    """Light at a point of a face, with coordinates -1…1 along its two axes."""
    grids, values = world.lights.grids, world.lights.values
    rows, columns = grids[index(solid), index(face), 1], grids[index(solid), index(face), 2]
    right, up = (0.5 + 0.5 * right) * (columns - 1), (0.5 + 0.5 * up) * (rows - 1)
    j = min(max(int(right), 0), columns - 2)
    i = min(max(int(up), 0), rows - 2)
    # The mean of several hits may lie slightly off the face.
    fu, fv = min(max(right - j, 0.0), 1.0), min(max(up - i, 0.0), 1.0)
    at = grids[index(solid), index(face), 0] + i * columns + j
    return float(
        (1.0 - fv) * ((1.0 - fu) * values[index(at)] + fu * values[index(at + 1)])
        + fv * ((1.0 - fu) * values[index(at + columns)] + fu * values[index(at + columns + 1)])
    )


@inlined
def light_on_mover(world: World, mover: int, normal: Vector) -> float:
    """Light on a moving solid: one directional light, and an ambient one, stronger from above.

    Nothing is baked for movers; `baking.light_movers` sets their `lights` in every frame.
    """
    light = world.movers.lights[mover]
    facing = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    return float(max(facing, 0.0) + light[3] * (0.8 + 0.2 * normal[2]))


@inlined
def light_on_ground(world: World, x: float, y: float) -> float:
    """Light at a point of the ground."""
    light = world.height_field.light
    return interpolate(light, grid_position(world, x, y, world.height_field.finer, light))


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
