"""Poses of the camera during an exposure, and the rays of its pixels with their derivatives."""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import Pair, Pose, Rotation, Vector
from data_synth.scene.kernels.vectors import rotate, rotate_xy
from data_synth.scene.shutter import Shutter
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
