"""Least-squares alignment of point sets in Sim(3) or SE(3)."""

from __future__ import annotations

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Bools, Floats

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
    found = umeyama_each(source[None], target[None], with_scale=with_scale)
    (scale,), (rotation,), (translation,), (is_on_line,), (is_spread,) = found
    if not is_spread:
        raise ValueError("all points are in one place")
    return Similarity(float(scale), rotation, translation, bool(is_on_line))


def umeyama_each(
    source: Floats, target: Floats, *, with_scale: bool
) -> tuple[Floats, Floats, Floats, Bools, Bools]:
    """`umeyama` for each of S sets of points (S, N, 3).

    Returns:
        (S,) scales, (S, 3, 3) rotations, (S, 3) translations, (S,) whether points are collinear,
        and (S,) whether they are not all in one place, where the others are undetermined.
    """
    mean_source, mean_target = source.mean(axis=1), target.mean(axis=1)  # (34), (35)
    centred_source, centred_target = source - mean_source[:, None], target - mean_target[:, None]
    variance_source = (centred_source**2).sum(axis=2).mean(axis=1)  # (36)
    variance_target = (centred_target**2).sum(axis=2).mean(axis=1)  # (37)
    is_spread = _is_spread(variance_source, mean_source) & _is_spread(variance_target, mean_target)
    covariance = centred_target.transpose(0, 2, 1) @ centred_source / source.shape[1]  # (38)
    u, d, vt = np.linalg.svd(covariance)
    signs = np.ones((len(d), 3))
    signs[np.linalg.det(u) * np.linalg.det(vt) < 0, 2] = -1.0  # (39), (43): not a reflection
    rotation = (u * signs[:, None]) @ vt  # (40)
    scale = np.ones(len(d))
    if with_scale:
        scale = (d * signs).sum(axis=1) / np.where(is_spread, variance_source, 1.0)  # (42)
    turned = (scale[:, None, None] * rotation @ mean_source[:, :, None])[:, :, 0]
    is_on_line = d[:, 1] <= _COLLINEAR_RATIO * d[:, 0]
    return scale, rotation, mean_target - turned, is_on_line, is_spread  # (41)


def line_direction(points: Floats) -> Floats:
    """Unit vector (3,) of the direction in which points (N, 3) have the largest variance."""
    _, _, vt = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return np.asarray(vt[0])


def _is_spread(variance: Floats, mean: Floats) -> Bools:
    """(S,) whether variances are above rounding, some 1e-16 of the mean per axis."""
    return np.asarray(variance > (1e-12 * np.maximum(1.0, np.abs(mean).max(axis=1))) ** 2)
