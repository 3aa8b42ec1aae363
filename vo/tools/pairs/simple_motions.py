"""Simpler explanations of matches than epipolar lines: a rotation of the camera, or a plane."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from vo.base.types import Floats
from vo.tools.pairs.sampson import point_errors

# Ratio of the inliers that a simpler model must leave over, by more than so many thresholds.
_MIN_BESIDE, _BESIDE = 0.05, 2.0


def rotation_between(first: Floats, second: Floats, matrices: tuple[Floats, Floats]) -> Floats:
    """The rotation (3, 3) that turns the rays of pixels (N, 2) best into those of the second image.

    Source: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976; twice,
    the second time with the nearer half only, as near points do not follow it.
    """
    rays = [_unit_rays(xy, matrix) for xy, matrix in zip((first, second), matrices, strict=True)]
    rotation = np.eye(3)
    rows: Any = slice(None)
    for _ in range(3):
        u, _, vt = np.linalg.svd(rays[1][rows].T @ rays[0][rows])
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        away = np.linalg.norm(rays[0] @ rotation.T - rays[1], axis=1)
        rows = away <= np.median(away)
    return np.asarray(rotation)


def rotation_errors(
    rotation: Floats, first: Floats, second: Floats, matrices: tuple[Floats, Floats]
) -> Floats:
    """Sampson distances (N,) in px from a pure rotation."""
    return point_errors(matrices[1] @ rotation @ np.linalg.inv(matrices[0]), first, second)


def plane_of(first: Floats, second: Floats, threshold_px: float) -> Floats | None:
    """The homography (3, 3) that explains matches (N, 2), all of which are right; None without."""
    try:
        found, _ = cv2.findHomography(
            np.ascontiguousarray(first), np.ascontiguousarray(second), cv2.RANSAC, threshold_px
        )
    except cv2.error:
        return None
    if found is None:
        return None
    homography = np.asarray(found, dtype=np.float64)
    errors = point_errors(homography, first, second)
    return homography if is_explained(errors, threshold_px) else None


def is_explained(error_px: Floats, threshold_px: float) -> bool:
    """Whether a simpler model leaves over so few matches that these may be noise."""
    return bool((error_px > _BESIDE * threshold_px).mean() < _MIN_BESIDE)


def inverse_matrix(matrix: Floats) -> Floats:
    """Inverse of a camera matrix (3, 3)."""
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _unit_rays(pixels: Floats, matrix: Floats) -> Floats:
    """Unit vectors (N, 3) of ideal pixels (N, 2)."""
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(matrix).T
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
