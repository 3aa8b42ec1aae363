"""Where the patches of points should be in other views, and how they look there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.compiling.function import NO_REFCOUNT, compiled
from vo.geometry.projection import Intrinsics, from_world, project
from vo.types import Floats, Ints

_NEAREST = 1e-3  # depth in distances of the reference camera below which nothing is predicted


class PatchPrediction(NamedTuple):
    """Patches in other views, (N,) pairs of a point and a camera.

    Attributes:
        xy: (N, 2) ideal pixels, NaN where the point is not in front of the camera.
        scale: (N,) size of the patch there against its reference.
        reference_from_target: (N, 2, 2) takes steps of pixels there back to the reference image.
        slope: (N, 2) how inverse depth changes from pixel to pixel there, relative to it, 1/px.
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
    """Project points into cameras, together with the neighbourhood that their patch shows.

    Two neighbours one pixel away on the point's surface are carried over.

    Args:
        points: (M, 3) in the world.
        normals: (M, 3) of the surfaces there, of any length; where unknown, the reference camera's
            axis.
        reference: (M,) row in world_from_cam of the camera that holds each point's patch.
        point: (N,) row in points of each pair.
        camera: (N,) row in world_from_cam of each pair.
        world_from_cam: (K, 4, 4).
        intrinsics: of all cameras.

    Source: Forster et al., SVO, 2014, sec. IV-B, whose patches all face their reference camera.
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
    """Points that a camera sees, and at a size like that of their patch.

    Attributes:
        rows: (n,) which.
        xy: (n, 2) ideal pixels.
    """

    rows: Ints
    xy: Floats


def points_in_view(
    points: Floats,
    reference: Ints,
    world_from_cam: Floats,
    intrinsics: Intrinsics,
    most_scale: float,
    corners: tuple[float, float, float, float],
) -> PointsInView:
    """The points that the last of some cameras sees, without what takes time for each.

    Args:
        points: (M, 3) in the world.
        reference: (M,) row in world_from_cam of the camera that holds each point's patch.
        world_from_cam: (K, 4, 4).
        intrinsics: of all cameras.
        most_scale: times that a patch may be larger or smaller than its reference, less than that.
        corners: least u, least v (inclusive), and what u and v are below, in ideal pixels.
    """
    return PointsInView(
        *_in_view(
            np.ascontiguousarray(points),
            reference,
            np.ascontiguousarray(world_from_cam),
            intrinsics,
            most_scale,
            corners,
        )
    )


@compiled
def _in_view(points, reference, poses, intrinsics, most_scale, corners):  # type: ignore[no-untyped-def]
    rows, xy = np.empty(len(points), dtype=np.int64), np.empty((len(points), 2))
    count = _add_in_view(points, reference, poses, intrinsics, most_scale, corners, rows, xy)
    return rows[:count].copy(), xy[:count].copy()


@compiled(**NO_REFCOUNT)
def _add_in_view(points, reference, poses, intrinsics, most_scale, corners, rows, xy):  # type: ignore[no-untyped-def]
    count = 0
    left, top, right, bottom = corners
    here = poses[-1]
    for n in range(len(points)):
        at, there = points[n], poses[reference[n]]
        x, y, z = from_world(here, at[0], at[1], at[2])
        then, now = _distance(there, at), _distance(here, at)
        if not z > _NEAREST * then:
            continue
        u, v = project(intrinsics, x, y, z)
        scale = then / now
        if left <= u < right and top <= v < bottom and 1.0 / most_scale < scale < most_scale:
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
    xy, scale, back, slope = found
    for n in range(len(point)):
        at, normal = points[point[n]], normals[point[n]]
        there, here = poses[reference[point[n]]], poses[camera[n]]
        x, y, z = from_world(here, at[0], at[1], at[2])
        then, now = _distance(there, at), _distance(here, at)
        if not z > _NEAREST * then:
            continue
        u, v = project(intrinsics, x, y, z)
        xy[n, 0], xy[n, 1], scale[n] = u, v, then / now
        ahead = _along(normal, here, at)
        if abs(ahead) > 1e-9 * now:
            slope[n, 0] = _dot(normal, here[:3, 0]) * z / (intrinsics.fx * ahead)
            slope[n, 1] = _dot(normal, here[:3, 1]) * z / (intrinsics.fy * ahead)
        depth = from_world(there, at[0], at[1], at[2])[2]
        a, c = _moved(at, normal, there, 0, depth / intrinsics.fx, here, intrinsics)
        b, d = _moved(at, normal, there, 1, depth / intrinsics.fy, here, intrinsics)
        a, c = a - u, c - v
        b, d = b - u, d - v
        determinant = a * d - b * c
        if 0.1 <= abs(determinant) <= 10.0:
            back[n, 0, 0], back[n, 0, 1] = d / determinant, -b / determinant
            back[n, 1, 0], back[n, 1, 1] = -c / determinant, a / determinant
        else:  # seen from the side, or from behind: as it was is as good a guess as any
            back[n, 0, 0] = back[n, 1, 1] = 1.0


@compiled(**NO_REFCOUNT)
def _distance(pose, at):  # type: ignore[no-untyped-def]
    x, y, z = at[0] - pose[0, 3], at[1] - pose[1, 3], at[2] - pose[2, 3]
    return np.sqrt(x * x + y * y + z * z)


@compiled(**NO_REFCOUNT)
def _moved(at, normal, there, axis, step, here, intrinsics):  # type: ignore[no-untyped-def]
    """Pixel of a point moved along its surface.

    It is moved by a step along an axis of another camera, then to the surface along its ray.
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
    """How far a point is from a camera, along a normal."""
    return (
        normal[0] * (at[0] - pose[0, 3])
        + normal[1] * (at[1] - pose[1, 3])
        + normal[2] * (at[2] - pose[2, 3])
    )


@compiled(**NO_REFCOUNT)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
