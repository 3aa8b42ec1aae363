"""Where in this image a point of the last one can be, whatever its depth."""

from __future__ import annotations

import numpy as np

from vo.geometry import cameras
from vo.geometry.transforms import inverse
from vo.types import Floats, Floats32, View

_NEAREST_IN_STEPS = 4.0  # depths from this many times the camera's step to infinity
_POINTS_ON_CURVE = 6


def epipolar_lines(
    view: View, previous_xy: Floats32, world_from_previous: Floats, world_from_cam0: Floats
) -> Floats:
    """Epipolar lines of pixels of the last frame, in this frame's image0.

    Args:
        view: of this frame.
        previous_xy: (n, 2) pixels in the last frame's image0.
        world_from_previous: (4, 4) of cam0 in the last frame.
        world_from_cam0: (4, 4) of cam0 in this frame.

    Returns:
        (n, k, 2) pixels: ends of a line, or points on a curve where a lens bends it; fewer rows
        where it is not in view, none where the camera has not moved.
    """
    turn = np.eye(4) if view.cam0_from_image0 is None else view.cam0_from_image0
    now_from_previous = inverse(world_from_cam0 @ turn) @ world_from_previous @ turn
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
    inverse_depths = np.arange(count) / ((count - 1) * _NEAREST_IN_STEPS * step)
    # Homogeneous points (ray, 1 / depth), so that infinity is a depth like any other.
    turned = rays @ now_from_previous[:3, :3].T
    points = turned[:, None] + inverse_depths[:, None] * now_from_previous[:3, 3]
    good = (points[:, :, 2] > 1e-3).all(axis=1) & np.isfinite(points).all(axis=(1, 2))
    seen = points[good, :, :2] / points[good, :, 2:]
    if view.lens is None:
        return np.asarray(seen * focal + centre)
    return cameras.distort(view.lens, seen.reshape(-1, 2)).reshape(seen.shape)
