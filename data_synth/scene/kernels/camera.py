"""Poses of the camera during an exposure, and the rays of its pixels with their derivatives."""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import (
    NOTHING,
    ZERO,
    Pair,
    Pose,
    Rotation,
    Sweep,
    Vector,
    View,
)
from data_synth.scene.kernels.vectors import add_scaled, rotate, rotate_back, rotate_xy, subtract
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.types import Floats

POSE_SIZE = 13  # numbers of a stored pose: rotation by rows, origin, time


@inlined
def pose_at(shutter: Shutter, rows: int, row: int, phase: float) -> Pose:
    """Pose of the camera at a phase, -0.5…0.5, of the exposure of a row.

    The time is in seconds since the frame's stamp: the middle of the exposure of the middle row of
    `rows`. Rotation matrices are interpolated entry by entry, because poses 2 ms apart are nearly
    equal: at 2 rad/s the result differs from a rotation by 2e-6.
    """
    at = shutter.first + shutter.per_row * row + phase * shutter.width
    time = shutter.step_s * (shutter.per_row * (row - 0.5 * (rows - 1)) + phase * shutter.width)
    last = len(shutter.origins) - 1
    at = min(max(at, 0.0), float(last))
    # Pose i and the next one, j, with weights g and f
    i = min(int(at), max(last - 1, 0))
    j, f = min(i + 1, last), at - i
    r, q, o, p = shutter.rotations[i], shutter.rotations[j], shutter.origins[i], shutter.origins[j]
    g = 1.0 - f
    return (
        (
            (g * r[0, 0] + f * q[0, 0], g * r[0, 1] + f * q[0, 1], g * r[0, 2] + f * q[0, 2]),
            (g * r[1, 0] + f * q[1, 0], g * r[1, 1] + f * q[1, 1], g * r[1, 2] + f * q[1, 2]),
            (g * r[2, 0] + f * q[2, 0], g * r[2, 1] + f * q[2, 1], g * r[2, 2] + f * q[2, 2]),
        ),
        (g * o[0] + f * p[0], g * o[1] + f * p[1], g * o[2] + f * p[2]),
        time,
    )


@inlined
def store_pose(pose: Pose, into: Floats) -> None:
    """Write a pose to (13,) numbers."""
    rotation, origin, time = pose
    for i in range(3):
        into[9 + i] = origin[i]
        for j in range(3):
            into[3 * i + j] = rotation[i][j]
    into[12] = time


@inlined
def load_pose(p: Floats) -> Pose:
    """Read a pose from (13,) numbers."""
    return ((p[0], p[1], p[2]), (p[3], p[4], p[5]), (p[6], p[7], p[8])), (p[9], p[10], p[11]), p[12]


@inlined
def world_ray(
    rays: Floats, row: int, column: int, rotation: Rotation
) -> tuple[Vector, Vector, Vector]:
    """The ray of a pixel in the world and its derivatives by column and row."""
    ray, across, down = pixel_ray(rays, row, column)
    return (
        rotate(rotation, (ray[0], ray[1], 1.0)),
        rotate_xy(rotation, across),
        rotate_xy(rotation, down),
    )


@inlined
def pixel_ray(rays: Floats, row: int, column: int) -> tuple[Pair, Pair, Pair]:
    """The ray (x, y, 1) of a pixel in the camera's frame and its derivatives by column and row.

    Differences to the next pixel; to the previous one at the border of the image circle.
    """
    x, y = rays[row, column, 0], rays[row, column, 1]
    if column + 1 < rays.shape[1] and not np.isnan(rays[row, column + 1, 0]):
        across = (rays[row, column + 1, 0] - x, rays[row, column + 1, 1] - y)
    else:
        across = (x - rays[row, column - 1, 0], y - rays[row, column - 1, 1])
    if row + 1 < rays.shape[0] and not np.isnan(rays[row + 1, column, 0]):
        down = (rays[row + 1, column, 0] - x, rays[row + 1, column, 1] - y)
    else:
        down = (x - rays[row - 1, column, 0], y - rays[row - 1, column, 1])
    if np.isnan(across[0]):
        across = (0.0, 0.0)
    if np.isnan(down[0]):
        down = (0.0, 0.0)
    return (x, y), across, down


@inlined
def exposure_sweep(shutter: Shutter, row: int) -> Sweep:
    """Motion of points in the camera's frame from the start to the end of a row's exposure.

    A point at t = 1/w on a ray r moves by (D r + w e) / w. Returns D, as rows, and e.
    """
    if shutter.width == 0.0:
        return (ZERO, ZERO, ZERO), ZERO
    middle, _, _ = pose_at(shutter, 1, row, 0.0)
    first, first_origin, _ = pose_at(shutter, 1, row, -0.5)
    last, last_origin, _ = pose_at(shutter, 1, row, 0.5)
    # With R, o of the middle and P = o + R r / w in the world, R_k^T (P - o_k) at both ends gives
    # D = (R_last - R_first)^T R, whose row k is R^T times column k of the difference, and
    # e = R^T (o_first - o_last), to first order.
    c = (subtract(last[0], first[0]), subtract(last[1], first[1]), subtract(last[2], first[2]))
    d = (
        rotate_back(middle, (c[0][0], c[1][0], c[2][0])),
        rotate_back(middle, (c[0][1], c[1][1], c[2][1])),
        rotate_back(middle, (c[0][2], c[1][2], c[2][2])),
    )
    return d, rotate_back(middle, subtract(first_origin, last_origin))


@inlined
def pixel_motion(
    world: World,
    shutter: Shutter,
    rays: Floats,
    sweep: Sweep,
    view: View,
    row: int,
    column: int,
) -> Pair:
    """Motion, in pixels across and down, of the surface point hit by the centre ray of a pixel."""
    number = view.surface[row, column]
    if shutter.width == 0.0 or number == NOTHING:
        return 0.0, 0.0
    inverse = 1.0 / view.depth[row, column]
    return surface_motion(world, shutter, rays, sweep, inverse, number, row, column)


@inlined
def surface_motion(
    world: World,
    shutter: Shutter,
    rays: Floats,
    sweep: Sweep,
    inverse: float,
    number: int,
    row: int,
    column: int,
) -> Pair:
    """Motion, in pixels across and down, of a surface of inverse depth `inverse` at a pixel.

    With m = D r + w (e + velocity * exposure), the ray (x, y, 1) changes by (m_x - x m_z,
    m_y - y m_z); the inverse of the derivatives of the ray by column and row gives pixels.
    """
    if shutter.width == 0.0:
        return 0.0, 0.0
    (x, y), across, down = pixel_ray(rays, row, column)
    d, e = sweep
    moved = add_scaled(rotate(d, (x, y, 1.0)), e, inverse)
    mover = number // 6 - len(world.bounds)
    if 0 <= mover < len(world.movers.bodies):
        v = world.movers.velocities[mover]
        rotation, _, _ = pose_at(shutter, 1, row, 0.0)
        velocity = rotate_back(rotation, (v[0], v[1], v[2]))
        moved = add_scaled(moved, velocity, shutter.width * shutter.step_s * inverse)
    mx, my = moved[0] - x * moved[2], moved[1] - y * moved[2]
    area = across[0] * down[1] - across[1] * down[0]
    if area == 0.0:  # a pixel without neighbours at the border of the image circle
        return 0.0, 0.0
    scale = 1.0 / area
    right = scale * (mx * down[1] - my * down[0])
    below = scale * (across[0] * my - across[1] * mx)
    # Rolling shutter: a point that moves down by v rows is exposed later by v * per_row poses,
    # which are v * per_row / width exposures, and moves on meanwhile. Solve for v:
    # v = below * (1 + v * per_row / width). The factor is limited to 2.
    if shutter.per_row != 0.0:
        late = 1.0 / (1.0 - min(below * shutter.per_row / shutter.width, 0.5))
        right, below = late * right, late * below
    return right, below
