"""Baking: the light on points of all surfaces, from lamps, the sun and the surroundings.

A lamp of power P and reach r adds P cos(θ) / (1 + d² / r²) at distance d, averaged over points of
its area, which makes shadows soft; the sun adds its power times cos(θ). Ambient light is multiplied
by _DARKEST + (1 - _DARKEST) times the fraction of directions that are free (ambient occlusion).
"""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.decorators import entry_point, inlined
from data_synth.scene.kernels.frames import outward_normal, to_world
from data_synth.scene.kernels.ground import ground_height, smooth_ground_normal
from data_synth.scene.kernels.occlusion import ambient_visibility, find_occluder
from data_synth.scene.kernels.records import (
    BOX,
    ELLIPSOID,
    FAR_M,
    GROUND,
    ROUND,
    SIDE,
    ZERO,
    Vector,
)
from data_synth.scene.kernels.vectors import add_scaled, axis_vector, dot, subtract
from data_synth.scene.world import World
from vo.base.types import Floats, Ints

_DARKEST = 0.35  # ambient light in the deepest corner
_LIFT_M = 0.012  # light is measured just above marks and rugs that lie on a surface
_GROUND_TINT = 1.1
_MIN_LIGHT = 0.004  # one grey level; lamps that add less are skipped


@entry_point
def bake_faces(
    world: World,
    faces: tuple[int, int],
    lamps: Floats,
    lamp_points: Floats,
    to_sky: Floats,
) -> None:
    """Bake the light on faces faces[0]…faces[1] - 1, where face = 6 * solid + side.

    `world`: its `lights.values` are written. `lamps`: (L, 5) centre, power and reach.
    `lamp_points`: (L, P, 3) points of each lamp, the first four of them its corners. `to_sky`: (K,
    3) directions above a surface along two tangents and its normal, all of the length up to which
    solids occlude.
    """
    lights, nearby = world.lights, np.empty(len(world.kinds), np.int64)
    for number in range(faces[0], faces[1]):
        solid, face = number // 6, number % 6
        begin, rows, columns = lights.grids[solid, face]
        for i in range(rows):
            for j in range(columns):
                # Grid points are evenly spaced over -1…1 and include the edges of the face.
                right, up = 2.0 * j / (columns - 1) - 1.0, 2.0 * i / (rows - 1) - 1.0
                local, normal = surface_point(world, solid, face, right, up)
                tint = ambient_tint(normal)
                local = add_scaled(local, normal, _LIFT_M)
                shape = world.shapes[solid]
                centre = (shape[0], shape[1], shape[2])
                point = add_scaled(to_world(world, solid, local), centre, 1.0)
                outward = to_world(world, solid, normal)
                lights.values[begin + i * columns + j] = total_light(
                    world, point, outward, tint, solid, lamps, lamp_points, to_sky, nearby
                )


@entry_point
def bake_ground(
    world: World, band: tuple[int, int], lamps: Floats, lamp_points: Floats, to_sky: Floats
) -> None:
    """Bake the light on rows band[0]…band[1] - 1 of the ground; `height_field.light` is written."""
    height_field = world.height_field
    light, step = height_field.light, height_field.cell / height_field.finer
    nearby = np.empty(len(world.kinds), np.int64)
    for i in range(band[0], band[1]):
        for j in range(light.shape[1]):
            x, y = height_field.corner[0] + step * j, height_field.corner[1] + step * i
            normal = smooth_ground_normal(world, x, y)
            point = add_scaled((x, y, ground_height(world, x, y)), normal, _LIFT_M)
            light[i, j] = total_light(
                world, point, normal, _GROUND_TINT, GROUND, lamps, lamp_points, to_sky, nearby
            )


@entry_point
def light_movers(world: World, centres: Floats, lights: Floats) -> None:
    """Set the light on moving solids, of the sun and of those lamps that are visible.

    `world`: the solids that do not move cast shadows. `centres`: (K, 3) of the moving solids.
    `lights`: (K, 4) the result: sum of direction times strength, and ambient light.
    """
    sources = world.sources
    for k in range(len(centres)):
        point = (centres[k, 0], centres[k, 1], centres[k, 2])
        total = ZERO
        sun = (sources.sun[0], sources.sun[1], sources.sun[2])
        if sources.sun_power > 0.0 and (
            find_occluder(world, point, add_scaled(ZERO, sun, FAR_M), GROUND) < 0
        ):
            total = add_scaled(total, sun, sources.sun_power)
        for lamp in range(len(sources.lamps)):
            x, y, z, power, reach = sources.lamps[lamp]
            to_lamp = subtract((x, y, z), point)
            square = dot(to_lamp, to_lamp)
            if (
                power > _MIN_LIGHT * (1.0 + square / reach**2)
                and find_occluder(world, point, to_lamp, GROUND) < 0
            ):
                strength = power / np.sqrt(square) / (1.0 + square / reach**2)
                total = add_scaled(total, to_lamp, strength)
        lights[k, 0], lights[k, 1], lights[k, 2] = total
        lights[k, 3] = sources.ambient


@inlined
def total_light(
    world: World,
    point: Vector,
    normal: Vector,
    tint: float,
    guess: int,
    lamps: Floats,
    lamp_points: Floats,
    to_sky: Floats,
    nearby: Ints,
) -> float:
    """Light at a point with a unit normal. `guess` is a solid that may occlude lamps."""
    visibility = ambient_visibility(world, point, normal, to_sky, nearby)
    total = world.sources.ambient * tint * (_DARKEST + (1.0 - _DARKEST) * visibility)
    sun = (world.sources.sun[0], world.sources.sun[1], world.sources.sun[2])
    facing = dot(normal, sun)
    if facing > 0.0 and find_occluder(world, point, add_scaled(ZERO, sun, FAR_M), guess) < 0:
        total += world.sources.sun_power * facing
    for k in range(len(lamps)):
        total += lamp_light(world, point, normal, lamps[k], lamp_points[k], guess)
    return total


@inlined
def ambient_tint(normal: Vector) -> float:
    """Factor of the ambient light by direction, so that edges are visible in the shade too."""
    x = 0.08 if normal[0] > 0.0 else -0.04
    y = 0.03 if normal[1] > 0.0 else -0.07
    z = 0.1 if normal[2] > 0.0 else -0.1
    return 1.0 + x * normal[0] ** 2 + y * normal[1] ** 2 + z * normal[2] ** 2


@inlined
def surface_point(
    world: World, solid: int, face: int, right: float, up: float
) -> tuple[Vector, Vector]:
    """Point and unit normal, in the frame of a solid, for a point -1…1 of a face of its cube.

    Points of the cube are projected onto curved surfaces towards the middle or the axis.
    """
    axis, sign = face // 2, 1.0 if face % 2 == 1 else -1.0
    if axis == 0:
        p = (sign, right, up)
    elif axis == 1:
        p = (right, sign, up)
    else:
        p = (right, up, sign)
    kind, shape = world.kinds[solid], world.shapes[solid]
    normal = axis_vector(axis, sign)
    if kind == ELLIPSOID:
        p = add_scaled(ZERO, p, 1.0 / np.sqrt(dot(p, p)))
    elif kind != BOX:
        radius = np.sqrt(p[0] * p[0] + p[1] * p[1])
        if axis < 2 or radius > 1.0:
            p = (p[0] / radius, p[1] / radius, p[2])
    hit = (p[0] * shape[3], p[1] * shape[4], p[2] * shape[5])
    if kind == ELLIPSOID:
        normal = outward_normal(world, solid, ROUND, 0, hit)
    elif kind != BOX and axis < 2:
        normal = outward_normal(world, solid, SIDE, 0, hit)
    return hit, normal


@inlined
def lamp_light(
    world: World, point: Vector, normal: Vector, lamp: Floats, lamp_points: Floats, guess: int
) -> float:
    """Light from those points (P, 3) of a lamp that are visible from a point of a surface."""
    to_lamp = (lamp[0] - point[0], lamp[1] - point[1], lamp[2] - point[2])
    if lamp[3] < _MIN_LIGHT * (1.0 + dot(to_lamp, to_lamp) / lamp[4] ** 2):
        return 0.0
    total, hidden = 0.0, 0
    for k in range(len(lamp_points)):
        if k == 4 and (hidden == 0 or hidden == 4):  # the corners agree: skip the other points
            return float(lamp[3] * total / 4.0)
        to_lamp = (
            lamp_points[k, 0] - point[0],
            lamp_points[k, 1] - point[1],
            lamp_points[k, 2] - point[2],
        )
        facing = dot(normal, to_lamp)
        if facing <= 0.0:
            hidden += 1
            continue
        occluder = find_occluder(world, point, to_lamp, guess)
        if occluder >= 0:
            guess = occluder
            hidden += 1
            continue
        square = dot(to_lamp, to_lamp)
        total += facing / np.sqrt(square) / (1.0 + square / lamp[4] ** 2)
    return float(lamp[3] * total / len(lamp_points))
