"""Which cameras of a rig see common points, from their frusta."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vo.base.geometry.cameras import normalise, project
from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Camera, Floats, Rig

DISTANCES_M = (1.0, 2.0, 5.0, 10.0, 30.0)
_GRID = 24  # points across an image
_MIN_RATIO = 0.03


class Overlap(NamedTuple):
    """Two cameras that see common points.

    Attributes:
        ratio: of the image of either, the smaller one, at the distance where most is in common.
        baseline_m: distance between the cameras.
    """

    first: int
    second: int
    ratio: float
    baseline_m: float


def overlap_ratios(rig: Rig) -> Floats:
    """(n, n, D) ratio of the image of camera i that camera j sees too, at D `DISTANCES_M`.

    The distance is that of points from camera i along their ray.
    """
    cameras, poses = rig.cameras, rig.cam0_from_cams
    ratios = np.ones((len(cameras), len(cameras), len(DISTANCES_M)))
    for i, camera in enumerate(cameras):
        rays = _rays(camera)
        for k, distance_m in enumerate(DISTANCES_M):
            points = distance_m * rays @ poses[i, :3, :3].T + poses[i, :3, 3]
            for j, other in enumerate(cameras):
                if i != j:
                    ratios[i, j, k] = np.mean(sees(other, poses[j], points))
    return ratios


@lru_cache(maxsize=8)  # a run calls it eight times, 7 ms in all
def overlaps(rig: Rig) -> tuple[Overlap, ...]:
    """Pairs of cameras that have 3 % of their images in common, most first."""
    poses = rig.cam0_from_cams
    ratios = overlap_ratios(rig)
    both = np.minimum(ratios, ratios.swapaxes(0, 1)).max(axis=2)
    found = [
        Overlap(i, j, float(both[i, j]), float(np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3])))
        for i in range(len(poses))
        for j in range(i + 1, len(poses))
        if both[i, j] >= _MIN_RATIO
    ]
    return tuple(sorted(found, key=lambda each: -each.ratio))


def is_rig(rig: Rig) -> bool:
    """Whether there are more than two cameras, or two that see nothing in common."""
    return bool(rig.further) or (rig.cam1 is not None and not overlaps(rig))


def sees(camera: Camera, cam0_from_cam: Floats, points: Floats) -> Bools:
    """Whether points (N, 3), in the frame of camera 0, are in the image of a camera."""
    cam_from_cam0 = inverse(cam0_from_cam)
    with np.errstate(invalid="ignore"):
        u, v = project(camera, points @ cam_from_cam0[:3, :3].T + cam_from_cam0[:3, 3]).T
        inside = (u > -0.5) & (u < camera.width - 0.5) & (v > -0.5) & (v < camera.height - 0.5)
    return np.asarray(inside)


def _rays(camera: Camera) -> Floats:
    """Unit rays (N, 3) of a grid of pixels, without those outside the circle of the lens."""
    rows = max(2, round(_GRID * camera.height / camera.width))
    u = (np.arange(_GRID) + 0.5) * camera.width / _GRID - 0.5
    v = (np.arange(rows) + 0.5) * camera.height / rows - 0.5
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = normalise(camera, pixels)
    rays = np.column_stack([rays, np.ones(len(rays))])[np.isfinite(rays).all(axis=1)]
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
