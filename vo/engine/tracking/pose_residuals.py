"""Residuals of landmarks at the pose of a frame, and robust fits of what may explain them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.mapping.tracked_frame import TrackedFrame

_LANDMARKS = 200  # examined; enough for a scale of 0.1 %
_ITERATIONS, _CAUCHY = 3, 3.0  # robust fit; scale in standard deviations of a pixel


class PoseFit(NamedTuple):
    """Corrections of a pose, and of what else was fitted: values and their information matrix."""

    values: Floats
    information: Floats
    weighted: Floats  # (k, 2n) weighted transposed derivatives
    left: Floats  # (2n,) residuals


class PoseResiduals(NamedTuple):
    """Residuals of n landmarks along x and y, for a focal length of 1.

    Attributes:
        xy: (2, n) where the pose sees the landmarks.
        row: (n,) rows in the image.
        error: (2n,) found minus expected.
        sigma: (2n,).
        by_pose: (2n, 6) derivatives by translation and rotation.
    """

    xy: Floats
    row: Floats
    error: Floats
    sigma: Floats
    by_pose: Floats

    def fit(self, others: Floats | None = None) -> PoseFit | None:
        """Robust fit of the pose and of other columns (2n, m); None with too few landmarks."""
        columns = self.by_pose if others is None else np.concatenate([self.by_pose, others], axis=1)
        left, variance = self.error, self.sigma**2
        for _ in range(_ITERATIONS):
            robust = 1.0 + self.squares(left) / _CAUCHY**2
            weight = np.concatenate([robust, robust]) * variance
            weighted = np.asarray(columns.T / weight, np.float64)
            information = weighted @ columns
            try:
                values = np.linalg.solve(information, weighted @ self.error)
            except np.linalg.LinAlgError:
                return None
            left = self.error - columns @ values
        return PoseFit(np.asarray(values, np.float64), information, weighted, left)

    def squares(self, left: Floats) -> Floats:
        """(n,) squared lengths of residuals (2n,) in standard deviations."""
        squares = (left / self.sigma) ** 2
        n = len(self.row)
        return np.asarray(squares[:n] + squares[n:])

    def cost(self, left: Floats) -> float:
        """Mean robust cost (Cauchy) of residuals (2n,)."""
        return float(np.log1p(self.squares(left) / _CAUCHY**2).mean())


def pose_residuals(rig: RectifiedRig, xyz: Floats, tracked: TrackedFrame) -> PoseResiduals:
    """Residuals of some of the landmarks that a frame observes; all of the map are at xyz."""
    observed = tracked.observed
    step = len(observed) // _LANDMARKS + 1
    cam_from_world = inverse(tracked.world_from_cam)
    p = xyz[observed.rows[::step]] @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    x, y, near = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], 1.0 / p[:, 2]
    found, sigma = observed.xy[::step], observed.sigma_px[::step] / rig.fx
    n = len(x)
    error, by_pose = np.empty(2 * n), np.zeros((2 * n, 6))
    error[:n] = (found[:, 0] - rig.cx) / rig.fx - x
    error[n:] = (found[:, 1] - rig.cy) / rig.fy - y
    by_pose[:n, 0] = by_pose[n:, 1] = near
    by_pose[:n, 2], by_pose[n:, 2] = -x * near, -y * near
    by_pose[:n, 3], by_pose[n:, 3] = -x * y, -1.0 - y * y
    by_pose[:n, 4], by_pose[n:, 4] = 1.0 + x * x, x * y
    by_pose[:n, 5], by_pose[n:, 5] = -y, x
    row, sigmas = observed.image_xy[::step, 1], np.concatenate([sigma, sigma])
    return PoseResiduals(np.stack([x, y]), row, error, sigmas, by_pose)


def median_length(residuals: Floats) -> float:
    """Median length of (2n,) residuals along x, and along y."""
    return median(np.hypot(*residuals.reshape(2, -1)))
