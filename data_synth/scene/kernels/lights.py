"""Look-up of the light on surfaces, which `baking` has computed; see `world.Lights`.

Radiance is texture times light; light 1 shows a white texture as white.
"""

from __future__ import annotations

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.frames import cube_face, to_world
from data_synth.scene.kernels.ground import grid_position, interpolate
from data_synth.scene.kernels.records import ROUND, SIDE, ZERO, Vector, index
from data_synth.scene.kernels.vectors import add_scaled, dominant_axis
from data_synth.scene.world import World


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
