"""Epipolar segments: images of a ray in a second view for a range of depths."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.projection import Intrinsics, pixel
from vo.base.types import Bools, Floats

# Minimum of d z_second / d z_first - min_depth_ratio for the limit of depth to be computed; below
# it nearly all depths satisfy the ratio, or none.
_MIN_MARGIN = 0.05
_MIN_DEPTH_RATIO = 1e-4  # of a depth in the second view to the farthest in the first


def epipolar_segments(
    xy: Floats,
    second_from_first: Floats,
    nearest: float,
    farthest: float,
    min_depth_ratio: float,
    intrinsics: Intrinsics,
) -> tuple[Floats, Floats, Bools]:
    """Ends of the epipolar segments of pixels.

    Args:
        xy: (n, 2) undistorted pixels of the first view.
        second_from_first: (4, 4).
        nearest: minimum depth in the first view.
        farthest: maximum depth there.
        min_depth_ratio: minimum of a point's depth in the second view relative to its depth in the
            first; nearer points are cut off the segment when the camera moves towards them.
        intrinsics: of both views.

    Returns:
        Undistorted pixels (n, 2) in the second view of the nearest and of the farthest point, and
        a mask (n,). Outside of the mask an end is behind the second camera, and both ends are NaN.
    """
    start, end, possible = _segments(
        np.ascontiguousarray(xy), second_from_first, nearest, farthest, min_depth_ratio, intrinsics
    )
    return start, end, possible


@compiled
def _segments(xy, motion, min_depth, farthest, min_depth_ratio, intrinsics):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = intrinsics
    ends = np.full((2, len(xy), 2), np.nan)
    possible = np.empty(len(xy), dtype=np.bool_)
    for n in range(len(xy)):
        x, y = (xy[n, 0] - cx) / fx, (xy[n, 1] - cy) / fy
        rx = motion[0, 0] * x + motion[0, 1] * y + motion[0, 2]
        ry = motion[1, 0] * x + motion[1, 1] * y + motion[1, 2]
        rz = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2]
        # A point at depth z has the depth rz * z + motion[2, 3] in the second view.
        nearest, margin = min_depth, rz - min_depth_ratio
        if margin > _MIN_MARGIN and motion[2, 3] < 0.0:
            nearest = max(nearest, -motion[2, 3] / margin)
        near_z = rz * nearest + motion[2, 3]
        far_z = rz * farthest + motion[2, 3]
        possible[n] = min(near_z, far_z) > _MIN_DEPTH_RATIO * farthest
        if possible[n]:
            x, y = (rx * nearest + motion[0, 3]) / near_z, (ry * nearest + motion[1, 3]) / near_z
            ends[0, n, 0], ends[0, n, 1] = pixel(intrinsics, x, y, 1.0)
            x, y = (rx * farthest + motion[0, 3]) / far_z, (ry * farthest + motion[1, 3]) / far_z
            ends[1, n, 0], ends[1, n, 1] = pixel(intrinsics, x, y, 1.0)
    return ends[0], ends[1], possible
