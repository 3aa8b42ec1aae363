"""A constant error of all disparities, seen in how the scene moves.

A stereo calibration that is off by a fraction of a pixel shifts every disparity by the same
amount: near points are placed almost right, far ones too far or too near. The way points move
while the camera moves shows their depths up to one common scale, so the two can be told apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.config import SmoothingConfig
from vo.smoothing.window import residuals
from vo.types import Floats, WindowProblem, WindowSolution


class DisparityOffset(NamedTuple):
    """Measured disparity = true disparity + `offset_px`, known to `sigma_px`."""

    offset_px: float
    sigma_px: float


def disparity_offset(
    problem: WindowProblem, solution: WindowSolution, config: SmoothingConfig
) -> DisparityOffset | None:
    """Estimate the offset together with all poses but the first and all points of a window.

    One Gauss-Newton step from the smoothed window, points eliminated by the Schur complement
    (Triggs et al., "Bundle Adjustment", 2000, sec. 6.1). None if the window does not determine it.
    """
    poses, points = solution.world_from_cam, solution.points
    sigma_disparity_px, huber = config.sigma_disparity_px, config.huber
    residual, depth = residuals(problem, poses, points, sigma_disparity_px)
    used = solution.point_ok[problem.point] & (depth > 0) & np.isfinite(residual)
    keyframes, size = len(poses), 6 * len(poses) + 1
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    point_hessian = np.zeros((len(points), 3, 3))
    point_gradient = np.zeros((len(points), 3))
    coupling = np.zeros((len(points), 3, size))
    for k in range(keyframes):
        rows = np.flatnonzero(used & (problem.keyframe == k))
        error, by_pose, by_point, by_offset = _linearised(
            problem, rows, poses[k], points, sigma_disparity_px, huber, residual
        )
        m, block = problem.point[rows], slice(6 * k, 6 * k + 6)
        hessian[block, block] += np.einsum("nri,nrj->ij", by_pose, by_pose)
        hessian[block, -1] += np.einsum("nri,nr->i", by_pose, by_offset)
        hessian[-1, -1] += np.sum(by_offset**2)
        gradient[block] += np.einsum("nri,nr->i", by_pose, error)
        gradient[-1] += np.sum(by_offset * error)
        point_hessian[m] += np.einsum("nri,nrj->nij", by_point, by_point)
        point_gradient[m] += np.einsum("nri,nr->ni", by_point, error)
        coupling[m, :, block] += np.einsum("nri,nrj->nij", by_point, by_pose)
        coupling[m, :, -1] += np.einsum("nri,nr->ni", by_point, by_offset)
    hessian[-1, :-1] = hessian[:-1, -1]
    free = np.r_[6:size]  # the first pose stays
    return _solve(hessian, gradient, point_hessian, point_gradient, coupling, free)


def _solve(
    hessian: Floats,
    gradient: Floats,
    point_hessian: Floats,
    point_gradient: Floats,
    coupling: Floats,
    free: np.ndarray,
) -> DisparityOffset | None:
    determined = np.linalg.eigvalsh(point_hessian)[:, 0] > 1e-9
    inverse = np.linalg.inv(point_hessian[determined])
    coupling = coupling[determined][:, :, free]
    flat = coupling.reshape(-1, len(free))
    eliminated = (inverse @ coupling).reshape(-1, len(free))
    reduced = hessian[np.ix_(free, free)] - flat.T @ eliminated
    right = gradient[free] - eliminated.T @ point_gradient[determined].ravel()
    try:
        covariance = np.linalg.inv(reduced)
    except np.linalg.LinAlgError:
        return None
    offset, variance = float(-(covariance @ right)[-1]), float(covariance[-1, -1])
    if not np.isfinite(offset) or not variance > 0:
        return None
    return DisparityOffset(offset, float(np.sqrt(variance)))


def _linearised(
    problem: WindowProblem,
    rows: np.ndarray,
    world_from_cam: Floats,
    points: Floats,
    sigma_disparity_px: float,
    huber: float,
    residual: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Errors (n, 3) and their derivatives by pose (n, 3, 6), point (n, 3, 3) and offset (n, 3)."""
    fx, fy, cx, cy = problem.intrinsics
    rotation = world_from_cam[:3, :3]
    p = (points[problem.point[rows]] - world_from_cam[:3, 3]) @ rotation
    x, y, z = p.T
    sigma = problem.sigma_px[rows]
    disparity = problem.disparity[rows]
    fb = fx * problem.baseline_m
    error = np.stack(
        [
            (fx * x / z + cx - problem.xy[rows, 0]) / sigma,
            (fy * y / z + cy - problem.xy[rows, 1]) / sigma,
            (fb / z - disparity) / sigma_disparity_px,
        ],
        axis=1,
    )
    by_cam = np.zeros((len(rows), 3, 3))
    by_cam[:, 0, 0], by_cam[:, 0, 2] = fx / z / sigma, -fx * x / z**2 / sigma
    by_cam[:, 1, 1], by_cam[:, 1, 2] = fy / z / sigma, -fy * y / z**2 / sigma
    by_cam[:, 2, 2] = -fb / z**2 / sigma_disparity_px
    by_offset = np.zeros((len(rows), 3))
    by_offset[:, 2] = 1.0 / sigma_disparity_px
    # A motion exp(xi) of the camera's own frame moves a point in it by -(rho + phi x p).
    cross = np.zeros((len(rows), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    by_pose = np.concatenate([by_cam @ cross, -by_cam], axis=2)
    by_point = by_cam @ rotation.T
    weight = np.sqrt(huber / np.maximum(residual[rows], huber))[:, None]
    weight = np.repeat(weight, 3, axis=1)
    weight[np.isnan(disparity), 2] = 0.0
    error = np.where(weight > 0, error, 0.0) * weight
    return error, by_pose * weight[..., None], by_point * weight[..., None], by_offset * weight
