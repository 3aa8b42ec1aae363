"""Packets of LANES rays that are intersected together, in vector instructions.

The rays of a packet are neighbours and have one list of candidates, so that each solid is loaded
once for LANES rays. A packet is an array of PACKET_SIZE numbers: rows of LANES, one number for each
ray. Rows 0…2 are the directions of the rays, 3…5 their origins, 6 their times since the frame's
stamp; rows 7 and 8 are the results: t of the nearest hit and the number of its surface.
"""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.frames import ground_number, load_shape, velocity_of
from data_synth.scene.kernels.ground import follow_ground, intersect_ground
from data_synth.scene.kernels.records import (
    BOX,
    ELLIPSOID,
    LANES,
    SKY,
    Candidates,
    Shape,
    Vector,
    index,
)
from data_synth.scene.kernels.solids import intersect_box, intersect_cylinder, intersect_ellipsoid
from data_synth.scene.world import World
from vo.base.types import Floats

_RAY, _START, _TIME, _T, _SURFACE = 0, 3 * LANES, 6 * LANES, 7 * LANES, 8 * LANES
PACKET_SIZE = 9 * LANES


@inlined
def set_ray(packet: Floats, lane: int, start: Vector, time: float, ray: Vector) -> None:
    """Set one ray of a packet."""
    for k in range(3):
        packet[index(_RAY + k * LANES + lane)] = ray[k]
        packet[index(_START + k * LANES + lane)] = start[k]
    packet[index(_TIME + lane)] = time


@inlined
def intersect_solids(world: World, packet: Floats, candidates: Candidates) -> None:
    """Set t and surface of the nearest solid that each ray of a packet meets.

    Loops over the rays have no branches and no array but the packet, so that they become vector
    instructions.
    """
    solids, entries = candidates.solids, candidates.entries
    for lane in range(LANES):
        packet[_T + lane], packet[_SURFACE + lane] = np.inf, float(SKY)
    for i in range(len(solids)):
        done = 0
        for lane in range(LANES):
            done += packet[_T + lane] <= entries[i]
        if done == LANES:  # entries ascend: all hits are nearer than the remaining solids
            break
        kind = world.kinds[index(solids[i])]
        if kind == BOX:
            intersect_box_packet(world, packet, solids[i])
        elif kind == ELLIPSOID:
            intersect_ellipsoid_packet(world, packet, solids[i])
        else:
            intersect_cylinder_packet(world, packet, solids[i])


@inlined
def intersect_box_packet(world: World, packet: Floats, solid: int) -> None:
    """Update the nearest hits by those of a box."""
    shape, velocity = load_shape(world, solid), velocity_of(world, solid)
    for lane in range(LANES):
        o, d = load_local_ray(packet, lane, shape, velocity)
        near, far, face = intersect_box(o, d, shape)
        keep_nearest(packet, lane, near, far, 6.0 * solid + face)


@inlined
def intersect_ellipsoid_packet(world: World, packet: Floats, solid: int) -> None:
    """Update the nearest hits by those of an ellipsoid."""
    shape, velocity = load_shape(world, solid), velocity_of(world, solid)
    for lane in range(LANES):
        o, d = load_local_ray(packet, lane, shape, velocity)
        near, far = intersect_ellipsoid(o, d, shape.inverse_x, shape.inverse_y, shape.inverse_z)
        keep_nearest(packet, lane, near, far, 6.0 * solid)


@inlined
def intersect_cylinder_packet(world: World, packet: Floats, solid: int) -> None:
    """Update the nearest hits by those of a cylinder."""
    shape, velocity = load_shape(world, solid), velocity_of(world, solid)
    for lane in range(LANES):
        o, d = load_local_ray(packet, lane, shape, velocity)
        near, far, face = intersect_cylinder(o, d, shape)
        keep_nearest(packet, lane, near, far, 6.0 * solid + face)


@inlined
def load_local_ray(
    packet: Floats, lane: int, shape: Shape, velocity: Vector
) -> tuple[Vector, Vector]:
    """Origin and direction of a ray of a packet in the frame of a solid at the time of the ray."""
    late = -packet[_TIME + lane]
    x = packet[_START + lane] + late * velocity[0] - shape.x
    y = packet[_START + LANES + lane] + late * velocity[1] - shape.y
    z = packet[_START + 2 * LANES + lane] + late * velocity[2] - shape.z
    u, v = packet[_RAY + lane], packet[_RAY + LANES + lane]
    cosine, sine = shape.cosine, shape.sine
    return (
        (cosine * x + sine * y, cosine * y - sine * x, z),
        (cosine * u + sine * v, cosine * v - sine * u, packet[_RAY + 2 * LANES + lane]),
    )


@inlined
def keep_nearest(packet: Floats, lane: int, near: float, far: float, number: float) -> None:
    """Store a surface that a ray enters at `near` if it is the nearest so far.

    Both results are always written, because a selection is vectorised and a branch is not. The
    number of a surface is stored as a float, which is exact up to 2^53.
    """
    t, before = packet[_T + lane], packet[_SURFACE + lane]
    is_nearest = (near > 0.0) & (near <= far) & (near < t)
    packet[_T + lane] = near if is_nearest else t
    packet[_SURFACE + lane] = number if is_nearest else before


@inlined
def nearest_hit(
    world: World, packet: Floats, lane: int, candidates: Candidates, guess: float
) -> tuple[float, int]:
    """Value of t and surface of the nearest hit of a ray, the ground included.

    To be called after `intersect_solids`; `guess` is a t near which the ray may meet the ground.
    """
    t = packet[index(_T + lane)]
    if candidates.ground_entry < t:
        ray = (
            packet[index(_RAY + lane)],
            packet[index(_RAY + LANES + lane)],
            packet[index(_RAY + 2 * LANES + lane)],
        )
        start = (
            packet[index(_START + lane)],
            packet[index(_START + LANES + lane)],
            packet[index(_START + 2 * LANES + lane)],
        )
        t_ground = -1.0
        if candidates.descent_end > 0.0:
            between = (candidates.ground_entry, candidates.descent_end)
            t_ground = follow_ground(world, start, ray, between, guess)
        if t_ground < 0.0:
            t_ground = intersect_ground(world, start, ray, candidates.ground_entry, t)
        if t_ground < t:
            return t_ground, ground_number(world)
    return t, int(packet[index(_SURFACE + lane)])
