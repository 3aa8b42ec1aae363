"""The ground below a camera: a plane through landmarks of the local map."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Floats

_SAMPLES = 300
_MIN_POINTS = 15  # on the plane
_THRESHOLD = 0.05  # distance from the plane, relative to the height of the camera
_MAX_DISTANCE = 12.0  # of points from the camera, in heights; farther ones are too uncertain
_MAX_BELOW = (
    0.5  # ratio of points below the plane to points on it: the ground is the lowest surface
)
_MAX_TILT = math.cos(math.radians(25.0))  # of the camera's axis y against the normal
_MAX_SLOPE = math.sin(math.radians(8.0))  # of the motion against the plane
_ABOVE = 4  # layers of the same thickness above the plane
_MIN_DENSITY = 3.0  # of points on the plane, relative to those layers: a cloud has planes, too
_MIN_SPREAD = 0.7  # of the points on the plane across and along, in heights


class Ground(NamedTuple):
    """A plane below the camera.

    Attributes:
        height: distance of the camera's centre, in the unit of the points.
        normal: (3,) unit vector down, in the frame of the points.
        points: number of points on it.
    """

    height: float
    normal: Floats
    points: int


def find_ground(in_cam: Floats, motion: Floats | None, rng: np.random.Generator) -> Ground | None:
    """The ground below an upright camera (x right, y down, z forward).

    Seeded samples of three points; a plane must be roughly below the axis y and parallel to the
    motion, and few points may lie below it. The last fit is by least squares.

    Args:
        in_cam: (N, 3) points in the frame of the camera.
        motion: (3,) direction of the motion in that frame, None if the camera stands still.
        rng: source of the samples.

    Returns:
        None if there is no such plane.
    """
    below = in_cam[(in_cam[:, 1] > 0.0) & (in_cam[:, 2] > 0.0)]
    if len(below) < _MIN_POINTS:
        return None
    best: tuple[float, Ground] | None = None
    for _ in range(_SAMPLES):
        plane = _plane_of(below[rng.choice(len(below), 3, replace=False)])
        if plane is None or not _is_plausible(plane[0], motion):
            continue
        score, on_plane = _score(below, *plane)
        if on_plane.sum() >= _MIN_POINTS and (best is None or score > best[0]):
            best = score, Ground(plane[1], plane[0], int(on_plane.sum()))
    return None if best is None else _refined(below, best[1], motion)


def _plane_of(points: Floats) -> tuple[Floats, float] | None:
    """Normal down and distance of the origin; None for points on a line."""
    centre = points.mean(axis=0)
    _, sizes, vt = np.linalg.svd(points - centre, full_matrices=False)
    if sizes[1] < 1e-3 * sizes[0]:
        return None
    normal = vt[2] if vt[2, 1] >= 0.0 else -vt[2]
    height = float(normal @ centre)
    return (normal, height) if height > 0.0 else None


def _is_plausible(normal: Floats, motion: Floats | None) -> bool:
    if normal[1] < _MAX_TILT:
        return False
    return motion is None or abs(float(normal @ motion)) <= _MAX_SLOPE


def _score(points: Floats, normal: Floats, height: float) -> tuple[float, Bools]:
    """Points on the plane, less those below it; only near ones count."""
    near = np.linalg.norm(points, axis=1) <= _MAX_DISTANCE * height
    distance = points @ normal - height
    on_plane = near & (np.abs(distance) <= _THRESHOLD * height)
    is_below = near & (distance > 2.0 * _THRESHOLD * height)
    if is_below.sum() > _MAX_BELOW * on_plane.sum():
        return -math.inf, on_plane
    return float(on_plane.sum() - is_below.sum()), on_plane


def _refined(points: Floats, ground: Ground, motion: Floats | None) -> Ground | None:
    normal, height = ground.normal, ground.height
    on_plane = np.zeros(len(points), bool)
    for _ in range(5):
        _, on_plane = _score(points, normal, height)
        if on_plane.sum() < _MIN_POINTS:
            return None
        plane = _plane_of(points[on_plane])
        if plane is None or not _is_plausible(plane[0], motion):
            return None
        normal, height = plane
    chosen = points[on_plane]
    across = np.cross(normal, (0.0, 0.0, 1.0))
    along = np.cross(across, normal)
    spread = min(float(np.std(chosen @ across)), float(np.std(chosen @ along)))
    if spread < _MIN_SPREAD * height:
        return None
    near = points[np.linalg.norm(points, axis=1) <= _MAX_DISTANCE * height]
    layer = (height - near @ normal) / (2.0 * _THRESHOLD * height)
    above = int(((layer > 0.5) & (layer < 0.5 + _ABOVE)).sum())
    if on_plane.sum() < _MIN_DENSITY * above / _ABOVE:
        return None
    return Ground(height, normal, int(on_plane.sum()))
