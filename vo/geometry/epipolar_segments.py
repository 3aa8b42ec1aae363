"""Where in a second view a pixel of the first can be, if its depth is known within limits."""

from __future__ import annotations

import numpy as np

from vo.compiling.function import compiled
from vo.geometry.projection import Intrinsics, pixel
from vo.types import Bools, Floats

_LEAST_MARGIN = 0.05  # below it all depths would do, or none
_LEAST_DEPTH = 1e-4  # in the second view, of the farthest depth in the first


def epipolar_segments(
    xy: Floats,
    second_from_first: Floats,
    nearest: float,
    farthest: float,
    smallest: float,
    intrinsics: Intrinsics,
) -> tuple[Floats, Floats, Bools]:
    """Ideal pixels (n, 2) in the second view for the nearest and the farthest depth, and a mask.

    Pixels outside of the mask (n,) have an end behind the second camera; their segments are NaN.

    Args:
        xy: (n, 2) ideal pixels of the first view.
        second_from_first: (4, 4).
        nearest: least depth in the first view.
        farthest: greatest depth there.
        smallest: share of its depth that a point must keep when the camera comes nearer; what is
            too near for that in the first view is left out of the segment.
        intrinsics: fx, fy, cx, cy of both views.
    """
    start, end, possible = _segments(
        np.ascontiguousarray(xy), second_from_first, nearest, farthest, smallest, intrinsics
    )
    return start, end, possible


@compiled
def _segments(xy, motion, least, farthest, smallest, intrinsics):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = intrinsics
    ends = np.full((2, len(xy), 2), np.nan)
    possible = np.empty(len(xy), dtype=np.bool_)
    for n in range(len(xy)):
        x, y = (xy[n, 0] - cx) / fx, (xy[n, 1] - cy) / fy
        rx = motion[0, 0] * x + motion[0, 1] * y + motion[0, 2]
        ry = motion[1, 0] * x + motion[1, 1] * y + motion[1, 2]
        rz = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2]
        # A point at depth d is at rz * d + motion[2, 3] in the second view.
        nearest, margin = least, rz - smallest
        if margin > _LEAST_MARGIN and motion[2, 3] < 0.0:
            nearest = max(nearest, -motion[2, 3] / margin)
        near_z = rz * nearest + motion[2, 3]
        far_z = rz * farthest + motion[2, 3]
        possible[n] = min(near_z, far_z) > _LEAST_DEPTH * farthest
        if possible[n]:
            x, y = (rx * nearest + motion[0, 3]) / near_z, (ry * nearest + motion[1, 3]) / near_z
            ends[0, n, 0], ends[0, n, 1] = pixel(intrinsics, x, y, 1.0)
            x, y = (rx * farthest + motion[0, 3]) / far_z, (ry * farthest + motion[1, 3]) / far_z
            ends[1, n, 0], ends[1, n, 1] = pixel(intrinsics, x, y, 1.0)
    return ends[0], ends[1], possible
