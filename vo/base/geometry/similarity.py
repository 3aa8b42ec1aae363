"""Least-squares alignment of point sets in Sim(3) or SE(3)."""

from __future__ import annotations

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Floats

# Points are collinear if the second singular value of their covariance is at most this times the
# first.
_COLLINEAR_RATIO = 1e-9


@frozen(eq=False)
class Similarity:
    """A similarity: `p_in_target = scale * rotation @ p_in_source + translation`.

    Attributes:
        scale: positive; 1 for a rigid motion.
        rotation: (3, 3), proper.
        translation: (3,) in the target's units.
        is_on_line: whether the aligned points are collinear, so that the rotation about their line
            is not determined.
    """

    scale: float
    rotation: Floats
    translation: Floats
    is_on_line: bool = False

    def transform_points(self, points: Floats) -> Floats:
        """Transform (N, 3) points from the source's frame to the target's."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def transform_poses(self, world_from_cam: Floats) -> Floats:
        """Transform (N, 4, 4) poses to the target's frame; their rotations stay orthonormal."""
        result = world_from_cam.copy()
        result[:, :3, :3] = self.rotation @ world_from_cam[:, :3, :3]
        result[:, :3, 3] = self.transform_points(world_from_cam[:, :3, 3])
        return result


def umeyama(source: Floats, target: Floats, *, with_scale: bool) -> Similarity:
    """Least-squares similarity from source to target points (N, 3), matched by row.

    Points may be collinear; one of the equally good proper rotations is returned then.

    Raises:
        ValueError: fewer than three points, different shapes, or all points in one place.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point
        patterns", IEEE PAMI 13(4), 1991; equation numbers stand beside the lines.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3:
        raise ValueError(f"points must be (N, 3) twice, not {source.shape} and {target.shape}")
    if len(source) < 3:
        raise ValueError(f"{len(source)} points, at least 3 needed")
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)  # (34), (35)
    centred_source, centred_target = source - mean_source, target - mean_target
    variance_source = float((centred_source**2).sum(axis=1).mean())  # (36)
    variance_target = float((centred_target**2).sum(axis=1).mean())  # (37)
    _check_spread(variance_source, mean_source)
    _check_spread(variance_target, mean_target)
    covariance = centred_target.T @ centred_source / len(source)  # (38)
    u, d, vt = np.linalg.svd(covariance)
    signs = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:  # (39), (43): a reflection would fit better
        signs[2] = -1.0
    rotation = u @ np.diag(signs) @ vt  # (40)
    scale = float(d @ signs) / variance_source if with_scale else 1.0  # (42)
    translation = mean_target - scale * rotation @ mean_source  # (41)
    return Similarity(scale, rotation, translation, bool(d[1] <= _COLLINEAR_RATIO * d[0]))


def line_direction(points: Floats) -> Floats:
    """Unit vector (3,) of the direction in which points (N, 3) have the largest variance."""
    _, _, vt = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return np.asarray(vt[0])


def _check_spread(variance: float, mean: Floats) -> None:
    """Raise ValueError if the variance is within rounding, some 1e-16 of the mean per axis."""
    if variance <= (1e-12 * max(1.0, float(np.abs(mean).max()))) ** 2:
        raise ValueError("all points are in one place")
