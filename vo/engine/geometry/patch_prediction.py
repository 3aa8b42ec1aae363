"""Prediction of patches in other views: position, scale and affine warp."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import NO_REFCOUNT, compiled
from vo.base.geometry.projection import Intrinsics, from_world, project
from vo.base.types import Floats, Ints

# Minimum depth, relative to the distance from the reference camera, for a prediction.
_MIN_DEPTH_RATIO = 1e-3
_MIN_COSINE = 1e-9  # between normal and ray, below which a surface is seen edge-on
# Range of the area of a pixel's image in the reference within which a warp is used.
_MIN_AREA_RATIO, _MAX_AREA_RATIO = 0.1, 10.0


class PatchPrediction(NamedTuple):
    """Patches of N pairs of a point and a camera.

    Attributes:
        xy: (N, 2) undistorted pixels, NaN where the point is not in front of the camera.
        scale: (N,) size of the patch in the target relative to the reference.
        reference_from_target: (N, 2, 2) warp of pixel offsets from the target to the reference.
        slope: (N, 2) gradient of inverse depth in the target relative to inverse depth, 1/px.
    """

    xy: Floats
    scale: Floats
    reference_from_target: Floats
    slope: Floats


def predict_patches(
    points: Floats,
    normals: Floats,
    reference: Ints,
    point: Ints,
    camera: Ints,
    world_from_cam: Floats,
    intrinsics: Intrinsics,
) -> PatchPrediction:
    """Project points, and the planes that their patches lie on, into cameras.

    The warp is the finite difference of the projection over one pixel of the reference: both
    neighbours of a point are intersected with its plane, then projected into the target.

    Points and normals (M, 3) of planes are in the world, with the row (M,) of the reference camera;
    pairs are rows (N,) of points and of target cameras in world_from_cam (K, 4, 4). Where a normal
    is unknown it is the optical axis of the reference camera.

    Source: Forster et al., "SVO", 2014, sec. IV-B, where patches are parallel to the image plane
        of their reference camera.
    """
    return PatchPrediction(
        *_predict(
            np.ascontiguousarray(points),
            np.ascontiguousarray(normals),
            reference,
            point,
            camera,
            np.ascontiguousarray(world_from_cam),
            intrinsics,
        )
    )


class PointsInView(NamedTuple):
    """Points within the image of a camera and within a range of scales.

    Attributes:
        rows: (n,) rows of the points.
        xy: (n, 2) undistorted pixels.
    """

    rows: Ints
    xy: Floats


def points_in_view(
    points: Floats,
    reference: Ints,
    world_from_cam: Floats,
    intrinsics: Intrinsics,
    max_scale: float,
    bounds: tuple[float, float, float, float],
) -> PointsInView:
    """Points that the last camera sees; cheaper than `predict_patches`.

    `reference` (M,) are rows in world_from_cam (K, 4, 4), the last is the camera. Scales differ
    by less than `max_scale`; `bounds` are min u, min v, and max u, max v (exclusive), undistorted.
    """
    return PointsInView(
        *_in_view(
            np.ascontiguousarray(points),
            reference,
            np.ascontiguousarray(world_from_cam),
            intrinsics,
            max_scale,
            bounds,
        )
    )


@compiled
def _in_view(points, reference, poses, intrinsics, max_scale, bounds):  # type: ignore[no-untyped-def]
    rows, xy = np.empty(len(points), dtype=np.int64), np.empty((len(points), 2))
    count = _add_in_view(points, reference, poses, intrinsics, max_scale, bounds, rows, xy)
    return rows[:count].copy(), xy[:count].copy()


@compiled(**NO_REFCOUNT)
def _add_in_view(points, reference, poses, intrinsics, max_scale, bounds, rows, xy):  # type: ignore[no-untyped-def]
    """Write rows and pixels of the points in view to `rows` and `xy`; gives their number."""
    count = 0
    left, top, right, bottom = bounds
    here = poses[-1]
    for n in range(len(points)):
        at, there = points[n], poses[reference[n]]
        x, y, z = from_world(here, at[0], at[1], at[2])
        then, now = _distance(there, at), _distance(here, at)
        if not z > _MIN_DEPTH_RATIO * then:
            continue
        u, v = project(intrinsics, x, y, z)
        scale = then / now
        if left <= u < right and top <= v < bottom and 1.0 / max_scale < scale < max_scale:
            rows[count], xy[count, 0], xy[count, 1] = n, u, v
            count += 1
    return count


@compiled
def _predict(points, normals, reference, point, camera, poses, intrinsics):  # type: ignore[no-untyped-def]
    count = len(point)
    xy = np.full((count, 2), np.nan)
    scale = np.zeros(count)
    back = np.zeros((count, 2, 2))
    slope = np.zeros((count, 2))
    found = xy, scale, back, slope
    _predict_each(points, normals, reference, point, camera, poses, intrinsics, found)
    return found


@compiled(**NO_REFCOUNT)
def _predict_each(points, normals, reference, point, camera, poses, intrinsics, found):  # type: ignore[no-untyped-def]
    """Fill `found`: xy, scale, reference_from_target and slope."""
    xy, scale, back, slope = found
    for n in range(len(point)):
        at, normal = points[point[n]], normals[point[n]]
        there, here = poses[reference[point[n]]], poses[camera[n]]
        x, y, z = from_world(here, at[0], at[1], at[2])
        then, now = _distance(there, at), _distance(here, at)
        if not z > _MIN_DEPTH_RATIO * then:
            continue
        u, v = project(intrinsics, x, y, z)
        xy[n, 0], xy[n, 1], scale[n] = u, v, then / now
        # On the plane n . X = h the inverse depth at normalised (x, y) is n . (x, y, 1) / h.
        ahead = _along(normal, here, at)
        if abs(ahead) > _MIN_COSINE * now:
            slope[n, 0] = _dot(normal, here[:3, 0]) * z / (intrinsics.fx * ahead)
            slope[n, 1] = _dot(normal, here[:3, 1]) * z / (intrinsics.fy * ahead)
        depth = from_world(there, at[0], at[1], at[2])[2]
        # Columns (a, c) and (b, d) of target_from_reference, which is then inverted. The number of
        # an axis is no literal: each would be compiled on its own.
        a, c = _moved(at, normal, there, np.int64(0), depth / intrinsics.fx, here, intrinsics)
        b, d = _moved(at, normal, there, np.int64(1), depth / intrinsics.fy, here, intrinsics)
        a, c = a - u, c - v
        b, d = b - u, d - v
        determinant = a * d - b * c
        if _MIN_AREA_RATIO <= abs(determinant) <= _MAX_AREA_RATIO:
            back[n, 0, 0], back[n, 0, 1] = d / determinant, -b / determinant
            back[n, 1, 0], back[n, 1, 1] = -c / determinant, a / determinant
        else:  # edge-on or from behind: unchanged
            back[n, 0, 0] = back[n, 1, 1] = 1.0


@compiled(**NO_REFCOUNT)
def _distance(pose, at):  # type: ignore[no-untyped-def]
    """From a camera to a point."""
    x, y, z = at[0] - pose[0, 3], at[1] - pose[1, 3], at[2] - pose[2, 3]
    return np.sqrt(x * x + y * y + z * z)


@compiled(**NO_REFCOUNT)
def _moved(at, normal, there, axis, step, here, intrinsics):  # type: ignore[no-untyped-def]
    """Pixel in camera `here` of a point moved within its plane.

    The point is moved by `step` along an axis of camera `there`, then along the ray of that camera
    back to the plane, if its distance changes by less than a factor of 2.
    """
    ahead = _along(normal, there, at)
    moved = ahead + step * _dot(normal, there[:3, axis])
    nearer = ahead / moved if 0.5 * abs(ahead) < moved * np.sign(ahead) < 2.0 * abs(ahead) else 1.0
    x, y, z = from_world(
        here,
        there[0, 3] + nearer * (at[0] + step * there[0, axis] - there[0, 3]),
        there[1, 3] + nearer * (at[1] + step * there[1, axis] - there[1, 3]),
        there[2, 3] + nearer * (at[2] + step * there[2, axis] - there[2, 3]),
    )
    if z == 0.0:
        return np.nan, np.nan
    return project(intrinsics, x, y, z)


@compiled(**NO_REFCOUNT)
def _along(normal, pose, at):  # type: ignore[no-untyped-def]
    """Distance of a point from a camera along a normal."""
    return (
        normal[0] * (at[0] - pose[0, 3])
        + normal[1] * (at[1] - pose[1, 3])
        + normal[2] * (at[2] - pose[2, 3])
    )


@compiled(**NO_REFCOUNT)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
