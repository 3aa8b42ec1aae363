"""Epipolar lines of points of the last image in this image."""

from __future__ import annotations

import numpy as np

from vo.base.geometry import cameras
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, Floats32, View

_MIN_DEPTH_IN_STEPS = 4.0  # depths from this multiple of the camera's step to infinity
_POINTS_ON_CURVE = 6


def epipolar_lines(
    view: View, previous_xy: Floats32, world_from_previous: Floats, world_from_cam0: Floats
) -> Floats:
    """Epipolar lines of pixels of the last frame, in this frame's image0.

    `previous_xy`: (n, 2) pixels in the last frame's image0. `world_from_previous`: (4, 4) of cam0
    in the last frame. `world_from_cam0`: (4, 4) of cam0 in this frame.

    Returns (n, k, 2) pixels: ends of a line, or points on a curve with lens distortion. Points
    behind the camera have no line; without camera motion there are no lines.
    """
    cam0_from_image0 = np.eye(4) if view.cam0_from_image0 is None else view.cam0_from_image0
    world_from_image0 = world_from_cam0 @ cam0_from_image0
    now_from_previous = inverse(world_from_image0) @ world_from_previous @ cam0_from_image0
    step = float(np.linalg.norm(now_from_previous[:3, 3]))
    count = 2 if view.lens is None else _POINTS_ON_CURVE
    if step < 1e-9:
        return np.empty((0, count, 2))
    matrix = view.camera_matrix
    focal, centre = np.diag(matrix)[:2], matrix[:2, 2]
    if view.lens is None:
        plane = (previous_xy - centre) / focal
    else:
        plane = cameras.normalise(view.lens, np.asarray(previous_xy, dtype=np.float64))
    rays = np.column_stack([plane, np.ones(len(plane))])
    inverse_depths = np.arange(count) / ((count - 1) * _MIN_DEPTH_IN_STEPS * step)
    # Homogeneous points (ray, 1 / depth), so that infinite depth needs no special case.
    rotated = rays @ now_from_previous[:3, :3].T
    points = rotated[:, None] + inverse_depths[:, None] * now_from_previous[:3, 3]
    valid = (points[:, :, 2] > 1e-3).all(axis=1) & np.isfinite(points).all(axis=(1, 2))
    projected = points[valid, :, :2] / points[valid, :, 2:]
    if view.lens is None:
        return np.asarray(projected * focal + centre)
    return cameras.distort(view.lens, projected.reshape(-1, 2)).reshape(projected.shape)
