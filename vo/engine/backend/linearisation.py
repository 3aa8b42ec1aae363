"""Linearised observations of a window."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.config import SmoothingConfig
from vo.base.geometry.projection import (
    by_world_axis,
    by_world_from_cam,
    from_world,
    pixel,
    point_derivatives,
)
from vo.base.types import Bools, Floats, Ints
from vo.engine.backend.residuals import Residuals
from vo.engine.backend.window_problem import WindowProblem
from vo.engine.geometry.points import by_points


class Linearised(NamedTuple):
    """N observations ordered by point, then keyframe, in standard deviations.

    The tangent xi = (rx ry rz tx ty tz) of a pose is that of world_from_cam @ exp(xi). The rows of
    an observation are u, v and disparity; the last is 0 where disparity was not measured.

    Attributes:
        starts: (M + 1,) first observation of each point.
        error: (N, 3) predicted - measured.
    """

    poses: int
    starts: Ints
    keyframe: Ints
    by_pose: Floats
    by_point: Floats
    error: Floats

    @property
    def seen(self) -> Ints:
        """(K,) number of observations of each pose."""
        return np.bincount(self.keyframe, minlength=self.poses)


def linearise(
    problem: WindowProblem,
    world_from_cam: Floats,
    points: Floats,
    point_ok: Bools,
    config: SmoothingConfig,
    at: Residuals,
) -> Linearised:
    """Linearise a window at poses (K, 4, 4) and points (M, 3), with Huber weights.

    Observations of points (M,) that are not ok, or are behind the camera, are left out.
    `at`: the residuals there.
    """
    residual, _, depth = at
    used = np.flatnonzero(point_ok[problem.point] & (depth > 0) & np.isfinite(residual))
    if (problem.keyframe[1:] < problem.keyframe[:-1]).any():
        used = used[np.argsort(problem.keyframe[used], kind="stable")]
    starts, rows = by_points(np.ones(len(points), dtype=bool), problem.point[used])
    order = used[rows]
    by_pose, by_point, error = _linearised(
        np.ascontiguousarray(world_from_cam),
        np.ascontiguousarray(points),
        order,
        problem.keyframe,
        problem.point,
        problem.xy,
        problem.disparity,
        problem.sigma_px,
        problem.sigma_disparity_px,
        residual,
        config.huber,
        problem.intrinsics,
        problem.intrinsics[0] * problem.baseline_m,
    )
    keyframe = problem.keyframe[order]
    poses = len(world_from_cam)
    return Linearised(poses, starts, keyframe, by_pose, by_point, error)


@compiled(fastmath={"contract"})
def _linearised(  # type: ignore[no-untyped-def]
    poses,
    points,
    order,
    keyframe,
    point,
    xy,
    disparity,
    sigma,
    sigma_d,
    residual,
    huber,
    intrinsics,
    fb,
):
    """`by_pose`, `by_point`, `error` of the observations in `order`; poses are world_from_cam."""
    count = len(order)
    by_pose, by_point = np.zeros((count, 3, 6)), np.zeros((count, 3, 3))
    error = np.zeros((count, 3))
    for n in range(count):
        i = order[n]
        j, m = keyframe[i], point[i]
        pose = poses[j]
        x, y, z = from_world(pose, points[m, 0], points[m, 1], points[m, 2])
        weight = np.sqrt(huber / max(residual[i], huber))
        s, near = weight / sigma[i], 1.0 / z
        measured = fb > 0.0 and not np.isnan(disparity[i])
        t = weight / sigma_d if measured else 0.0
        u, v = pixel(intrinsics, x, y, near)
        error[n, 0], error[n, 1] = s * (u - xy[i, 0]), s * (v - xy[i, 1])
        error[n, 2] = t * (fb * near - disparity[i]) if measured else 0.0
        in_cam = point_derivatives(s * intrinsics.fx, s * intrinsics.fy, t * fb, x, y, near, near)
        for k in range(3):
            of_axis = by_world_axis(in_cam, pose[k, 0], pose[k, 1], pose[k, 2])
            by_point[n, 0, k], by_point[n, 1, k], by_point[n, 2, k] = of_axis
        by_u, by_v, by_d = by_world_from_cam(in_cam, x, y, z)
        for k in range(6):
            by_pose[n, 0, k], by_pose[n, 1, k], by_pose[n, 2, k] = by_u[k], by_v[k], by_d[k]
    return by_pose, by_point, error
