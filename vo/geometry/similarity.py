"""The similarity that best lays one set of points onto another, Sim(3) or SE(3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.types import Floats

_LINE_RATIO = 1e-9


@dataclass(frozen=True, eq=False)
class Similarity:
    """A similarity: `p_in_target = scale * rotation @ p_in_source + translation`.

    Attributes:
        scale: positive; 1 for a rigid motion.
        rotation: (3, 3), proper.
        translation: (3,) in the target's units.
        is_on_line: whether the points it came from lie on one line, so that the rotation about that
            line is a choice, not a finding.
    """

    scale: float
    rotation: Floats
    translation: Floats
    is_on_line: bool = False

    def transform_points(self, points: Floats) -> Floats:
        """Carry (N, 3) points from the source's frame to the target's."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def transform_poses(self, world_from_cam: Floats) -> Floats:
        """Carry (N, 4, 4) poses to the target's frame; their rotations stay rotations."""
        result = world_from_cam.copy()
        result[:, :3, :3] = self.rotation @ world_from_cam[:, :3, :3]
        result[:, :3, 3] = self.transform_points(world_from_cam[:, :3, 3])
        return result


def umeyama(source: Floats, target: Floats, *, with_scale: bool) -> Similarity:
    """The least-squares similarity from points (N, 3) to their partners (N, 3), row by row.

    Points on one line are allowed: of the rotations that fit equally well, one proper one is taken.

    Raises:
        ValueError: fewer than three points, shapes that differ, or points all in one place.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point
        patterns, IEEE PAMI 13(4), 1991; numbers of its equations beside the lines.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3:
        raise ValueError(f"points must be (N, 3) twice, not {source.shape} and {target.shape}")
    if len(source) < 3:
        raise ValueError(f"{len(source)} points, at least 3 needed")
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)  # (34), (35)
    centred_source, centred_target = source - mean_source, target - mean_target
    variance_source = float((centred_source**2).sum(axis=1).mean())  # (36)
    variance_target = float((centred_target**2).sum(axis=1).mean())  # (37)
    _need_spread(variance_source, mean_source)
    _need_spread(variance_target, mean_target)
    covariance = centred_target.T @ centred_source / len(source)  # (38)
    u, d, vt = np.linalg.svd(covariance)
    signs = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:  # (39), (43): a reflection would fit better
        signs[2] = -1.0
    rotation = u @ np.diag(signs) @ vt  # (40)
    scale = float(d @ signs) / variance_source if with_scale else 1.0  # (42)
    translation = mean_target - scale * rotation @ mean_source  # (41)
    return Similarity(scale, rotation, translation, bool(d[1] <= _LINE_RATIO * d[0]))


def line_direction(points: Floats) -> Floats:
    """Unit vector (3,) along which points (N, 3) spread most."""
    _, _, vt = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return np.asarray(vt[0])


def _need_spread(variance: float, mean: Floats) -> None:
    """Rounding alone spreads equal points by some 1e-16 of their distance from the origin."""
    if variance <= (1e-12 * max(1.0, float(np.abs(mean).max()))) ** 2:
        raise ValueError("all points are in one place")
