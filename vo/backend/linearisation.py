"""A window's observations, linearised at its solution."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.backend.residuals import residuals
from vo.backend.window_problem import WindowProblem
from vo.compiling.function import compiled
from vo.types import Bools, Floats, Ints

if TYPE_CHECKING:  # the smoother's process does without the settings, see `vo.backend.process`
    from vo.config import SmoothingConfig


class Linearised(NamedTuple):
    """N observations, those of a point together and by keyframe, in standard deviations.

    The tangent of a pose is (rx ry rz tx ty tz) in the camera's own frame; the rows of an
    observation are u, v and disparity, which is all 0 where it was not measured.

    Attributes:
        poses: how many there are.
        starts: (M + 1,) first observation of each point.
        keyframe: (N,) pose of each observation.
        by_pose: (N, 3, 6) derivatives.
        by_point: (N, 3, 3) derivatives.
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
        """(K,) observations that each pose has."""
        return np.bincount(self.keyframe, minlength=self.poses)


def linearise(
    problem: WindowProblem,
    world_from_cam: Floats,
    points: Floats,
    point_ok: Bools,
    config: SmoothingConfig,
) -> Linearised:
    """Linearise a window with Huber weights; points that are not ok have no observations."""
    residual, depth = residuals(problem, world_from_cam, points)
    used = np.flatnonzero(point_ok[problem.point] & (depth > 0) & np.isfinite(residual))
    order = used[np.lexsort((problem.keyframe[used], problem.point[used]))]
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
        np.sqrt(config.huber / np.maximum(residual, config.huber)),
        np.array(problem.intrinsics),
        problem.intrinsics[0] * problem.baseline_m,
    )
    starts = np.searchsorted(problem.point[order], np.arange(len(points) + 1))
    keyframe = problem.keyframe[order]
    poses = len(world_from_cam)
    return Linearised(poses, starts, keyframe, by_pose, by_point, error)


@compiled(fastmath={"contract"})
def _linearised(  # type: ignore[no-untyped-def]
    poses, points, order, keyframe, point, xy, disparity, sigma, sigma_d, weight, intrinsics, fb
):
    fx, fy, cx, cy = intrinsics
    count = len(order)
    by_pose, by_point = np.zeros((count, 3, 6)), np.zeros((count, 3, 3))
    error = np.zeros((count, 3))
    for n in range(count):
        i = order[n]
        j, m = keyframe[i], point[i]
        d0, d1, d2 = (
            points[m, 0] - poses[j, 0, 3],
            points[m, 1] - poses[j, 1, 3],
            points[m, 2] - poses[j, 2, 3],
        )
        x = poses[j, 0, 0] * d0 + poses[j, 1, 0] * d1 + poses[j, 2, 0] * d2
        y = poses[j, 0, 1] * d0 + poses[j, 1, 1] * d1 + poses[j, 2, 1] * d2
        z = poses[j, 0, 2] * d0 + poses[j, 1, 2] * d1 + poses[j, 2, 2] * d2
        s, near = weight[i] / sigma[i], 1.0 / z  # one division serves all
        measured = fb > 0.0 and not np.isnan(disparity[i])
        t = weight[i] / sigma_d if measured else 0.0
        error[n, 0] = s * (fx * x * near + cx - xy[i, 0])
        error[n, 1] = s * (fy * y * near + cy - xy[i, 1])
        error[n, 2] = t * (fb * near - disparity[i]) if measured else 0.0
        du, dv = s * fx * near, s * fy * near
        cu, cv, cd = -du * x * near, -dv * y * near, -t * fb * near * near
        for k in range(3):
            by_point[n, 0, k] = du * poses[j, k, 0] + cu * poses[j, k, 2]
            by_point[n, 1, k] = dv * poses[j, k, 1] + cv * poses[j, k, 2]
            by_point[n, 2, k] = cd * poses[j, k, 2]
        # A motion exp(xi) of the camera's own frame moves a point in it by -(rho + phi x p).
        by_pose[n, 0, 0], by_pose[n, 0, 1], by_pose[n, 0, 2] = -cu * y, cu * x - du * z, du * y
        by_pose[n, 1, 0], by_pose[n, 1, 1], by_pose[n, 1, 2] = dv * z - cv * y, cv * x, -dv * x
        by_pose[n, 2, 0], by_pose[n, 2, 1] = -cd * y, cd * x
        by_pose[n, 0, 3], by_pose[n, 0, 5] = -du, -cu
        by_pose[n, 1, 4], by_pose[n, 1, 5] = -dv, -cv
        by_pose[n, 2, 5] = -cd
    return by_pose, by_point, error
