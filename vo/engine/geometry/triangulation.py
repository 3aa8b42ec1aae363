"""Triangulation of points from two views."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.projection import Intrinsics, project, to_camera
from vo.base.types import Bools, Floats


def triangulate(
    second_from_first: Floats, rays_first: Floats, rays_second: Floats
) -> tuple[Floats, Floats]:
    """Triangulate by the midpoint method: the middle of the shortest line between two rays.

    It needs no SVD, and the optimizer refines the points.

    `second_from_first` (4, 4), normalised image points (N, 2), x/z and y/z, in both views.

    Returns:
        Points (N, 3) in the first camera's frame, with negative depth where rays diverge, infinite
        where they are parallel; and the angles (N,) between the rays in rad.

    Source: Hartley and Sturm, "Triangulation", 1997.
    """
    centre = -second_from_first[:3, :3].T @ second_from_first[:3, 3]
    points, angle = _triangulate(
        np.ascontiguousarray(second_from_first),
        centre,
        np.ascontiguousarray(rays_first),
        np.ascontiguousarray(rays_second),
    )
    return points, angle


@compiled
def _triangulate(pose, centre, first, second):  # type: ignore[no-untyped-def]
    """`centre` is the second camera's position in the first frame; a and b are unit rays there."""
    points, angle = np.empty((len(first), 3)), np.empty(len(first))
    a, b = np.empty(3), np.empty(3)
    for n in range(len(first)):
        x, y = second[n]
        length_a = np.sqrt(first[n, 0] ** 2 + first[n, 1] ** 2 + 1.0)
        length_b = np.sqrt(x * x + y * y + 1.0)
        a[0], a[1], a[2] = first[n, 0] / length_a, first[n, 1] / length_a, 1.0 / length_a
        for i in range(3):
            b[i] = (pose[0, i] * x + pose[1, i] * y + pose[2, i]) / length_b
        cosine, ahead_a, ahead_b = 0.0, 0.0, 0.0
        for i in range(3):
            cosine += a[i] * b[i]
            ahead_a += a[i] * centre[i]
            ahead_b += b[i] * centre[i]
        sine_squared = (
            (a[1] * b[2] - a[2] * b[1]) ** 2
            + (a[2] * b[0] - a[0] * b[2]) ** 2
            + (a[0] * b[1] - a[1] * b[0]) ** 2
        )
        angle[n] = np.arctan2(np.sqrt(sine_squared), cosine)
        if sine_squared > 0.0:
            along_a = (ahead_a - cosine * ahead_b) / sine_squared
            along_b = (cosine * ahead_a - ahead_b) / sine_squared
            for i in range(3):
                points[n, i] = 0.5 * (a[i] * along_a + centre[i] + b[i] * along_b)
        size = abs(points[n, 0]) + abs(points[n, 1]) + abs(points[n, 2])
        if not (sine_squared > 0.0 and np.isfinite(size)):
            for i in range(3):
                points[n, i] = np.inf
    return points, angle


def in_front(points: Floats, second_from_first: Floats) -> Bools:
    """Mask (N,) of points (N, 3) in the first camera's frame that are in front of both cameras."""
    with np.errstate(invalid="ignore"):
        depth_second = points @ second_from_first[2, :3] + second_from_first[2, 3]
        return np.asarray((points[:, 2] > 0) & (depth_second > 0) & np.isfinite(depth_second))


class TriangulatedPoints(NamedTuple):
    """Points triangulated from matched pixels of two views by one camera.

    Attributes:
        xyz: (N, 3) in the first camera's frame.
        valid: (N,) in front of both cameras, with sufficient parallax and small reprojection error.
        angle: (N,) between the rays in rad (parallax).
    """

    xyz: Floats
    valid: Bools
    angle: Floats


def triangulate_pixels(
    second_from_first: Floats,
    xy_first: Floats,
    xy_second: Floats,
    intrinsics: Intrinsics,
    *,
    min_parallax_rad: float,
    min_parallax_ratio: float,
    max_error_px: float,
    reach_px: Floats | None = None,
) -> TriangulatedPoints:
    """Triangulate matched pixels and check the points.

    Undistorted pixels (N, 2) of both views; rays must differ by `min_parallax_rad`, and by
    `min_parallax_ratio` of the angle by which the point has moved in the image; errors of
    reprojection must be below `max_error_px` in either view. If pixels of the second view may still
    move by `reach_px` (N,), valid are those that may then have enough parallax.
    """
    found = _triangulate_pixels(
        np.ascontiguousarray(second_from_first),
        -second_from_first[:3, :3].T @ second_from_first[:3, 3],
        np.ascontiguousarray(xy_first),
        np.ascontiguousarray(xy_second),
        intrinsics,
        min_parallax_rad,
        min_parallax_ratio,
        max_error_px,
        np.empty(0) if reach_px is None else reach_px,
    )
    return TriangulatedPoints(*found)


@compiled
def _triangulate_pixels(  # type: ignore[no-untyped-def]
    motion, centre, first, second, intrinsics, min_rad, min_ratio, max_px, reach_px
):
    points, angle = _triangulate(
        motion, centre, _rays(first, intrinsics), _rays(second, intrinsics)
    )
    limits = min_rad, min_ratio, max_px, reach_px
    return points, _valid(motion, points, angle, first, second, intrinsics, limits), angle


@compiled
def _rays(xy, intrinsics):  # type: ignore[no-untyped-def]
    rays = np.empty_like(xy)
    for n in range(len(xy)):
        rays[n, 0] = (xy[n, 0] - intrinsics.cx) / intrinsics.fx
        rays[n, 1] = (xy[n, 1] - intrinsics.cy) / intrinsics.fy
    return rays


@compiled
def _valid(motion, points, angle, first, second, intrinsics, limits):  # type: ignore[no-untyped-def]
    min_rad, min_ratio, max_px, reach_px = limits
    valid = np.zeros(len(points), dtype=np.bool_)
    for n in range(len(points)):
        x, y, z = points[n]
        moved_rad = np.hypot(
            (second[n, 0] - first[n, 0]) / intrinsics.fx,
            (second[n, 1] - first[n, 1]) / intrinsics.fy,
        )
        enough = max(min_rad, min_ratio * moved_rad)
        if len(reach_px) > 0:
            valid[n] = not angle[n] + reach_px[n] / intrinsics.fx < enough
            continue
        if not (0.0 < z < np.inf and angle[n] >= enough):
            continue
        u, v = project(intrinsics, x, y, z)
        if np.hypot(u - first[n, 0], v - first[n, 1]) >= max_px:
            continue
        x, y, z = to_camera(motion, x, y, z)
        if z > 0.0:
            u, v = project(intrinsics, x, y, z)
            valid[n] = np.hypot(u - second[n, 0], v - second[n, 1]) < max_px
    return valid
