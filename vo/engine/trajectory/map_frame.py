"""From the odometry frame to the map frame: keyframes that follow one that was placed."""

from __future__ import annotations

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.transforms import adjoint, inverse
from vo.base.types import Floats, Ints


@frozen(eq=False)
class Anchor:
    """A keyframe that the pose graph has placed; others of its segment follow it.

    Or one for each of n keyframes that follow, with n as the first dimension of all fields.

    Attributes:
        scale: length in the map of one unit of the odometry frame.
        added_covariance: (6, 6) that of the placed pose less that of the odometry, in the frame of
            the camera and in units of the map; 0 if it is unknown.
    """

    odom_from_cam: Floats
    map_from_cam: Floats
    scale: float | Floats
    added_covariance: Floats

    def rows(self, rows: Ints) -> Anchor:
        """Those of some of n keyframes."""
        return Anchor(
            self.odom_from_cam[rows],
            self.map_from_cam[rows],
            np.asarray(self.scale)[rows],
            self.added_covariance[rows],
        )

    def row(self, row: int) -> Anchor:
        """That of one of n keyframes."""
        scale = float(np.asarray(self.scale)[row])
        added = self.added_covariance[row]
        return Anchor(self.odom_from_cam[row], self.map_from_cam[row], scale, added)

    def transform(self, odom_from_cam: Floats) -> Floats:
        """Poses (..., 4, 4) in the map frame."""
        moved = inverse(self.odom_from_cam) @ odom_from_cam
        moved[..., :3, 3] *= np.asarray(self.scale)[..., None]
        return np.asarray(self.map_from_cam @ moved)

    def transform_points(self, points: Floats) -> Floats:
        """Points (N, 3) of the odometry frame in the map frame."""
        in_cam = (points - self.odom_from_cam[:3, 3]) @ self.odom_from_cam[:3, :3]
        return np.asarray(
            self.scale * in_cam @ self.map_from_cam[:3, :3].T + self.map_from_cam[:3, 3]
        )

    def covariance(self, odom_from_cam: Floats, covariance: Floats) -> Floats:
        """Covariances (n, 6, 6) in the map of poses (n, 4, 4) with their covariance in odometry.

        The covariance of the odometry, plus the change by the pose graph at the anchor.
        """
        scaled = scaled_covariance(covariance, self.scale)
        cam_from_anchor = inverse(odom_from_cam) @ self.odom_from_cam
        cam_from_anchor[..., :3, 3] *= np.asarray(self.scale)[..., None]
        moved = adjoint(cam_from_anchor)
        total = scaled + moved @ self.added_covariance @ np.swapaxes(moved, -1, -2)
        values, vectors = np.linalg.eigh(0.5 * (total + np.swapaxes(total, -1, -2)))
        floored = np.maximum(values, 1e-3 * np.abs(values[..., -1:]))
        return np.asarray((vectors * floored[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def make_anchors(
    odom_from_cam: Floats,
    map_from_cam: Floats,
    scale: Floats,
    odom_covariance: Floats,
    map_covariance: Floats,
) -> Anchor:
    """Anchors of n keyframes; covariances (n, 6, 6) are NaN where they are unknown."""
    added = map_covariance - scaled_covariance(odom_covariance, scale)
    added[~np.isfinite(added).all(axis=(1, 2))] = 0.0
    return Anchor(odom_from_cam, map_from_cam, scale, added)


def scaled_covariance(covariance: Floats, scale: float | Floats) -> Floats:
    """Covariances (..., 6, 6) of poses in another unit of length, or of (n, 6, 6) in n units."""
    factor = np.ones((*np.shape(scale), 6))
    factor[..., 3:] = np.asarray(scale)[..., None]
    return np.asarray(covariance * factor[..., None, :] * factor[..., :, None])
