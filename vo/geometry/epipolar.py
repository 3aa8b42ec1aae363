"""Two views of a scene: essential matrix and homography, with their symmetric errors."""

from __future__ import annotations

import cv2
import numpy as np

from vo.geometry.transforms import make_transform, skew
from vo.types import Bools, Floats

# Depth in lengths of the translation up to which points have a say in the sign of the motion.
# OpenCV's own 50 leaves none where the camera has moved little, and then any of the four wins.
_FARTHEST = 1e6


def find_essential(
    first: Floats, second: Floats, matrix: Floats, threshold_px: float
) -> tuple[Floats, Bools] | None:
    """Essential matrix of ideal pixels (N, 2) in two views, and its inliers; None if undetermined.

    Source: Nister 2004 (five points) inside OpenCV's USAC; plain RANSAC where that gives nothing.
    """
    if len(first) < 8:
        return None
    k = np.ascontiguousarray(matrix)
    a, b = np.ascontiguousarray(first), np.ascontiguousarray(second)
    for method in (cv2.USAC_DEFAULT, cv2.RANSAC):
        essential, mask = cv2.findEssentialMat(a, b, k, method, 0.999, threshold_px)
        if essential is not None and essential.shape == (3, 3):
            return np.asarray(essential), np.asarray(mask.ravel() > 0)
    return None


def recover_motion(
    essential: Floats, first: Floats, second: Floats, matrix: Floats, inlier: Bools
) -> Floats:
    """second_from_first (4, 4), with a translation of length 1, that puts most points in front."""
    mask = inlier.astype(np.uint8)[:, None].copy()
    _, rotation, translation, _, _ = cv2.recoverPose(
        essential,
        np.ascontiguousarray(first),
        np.ascontiguousarray(second),
        np.ascontiguousarray(matrix),
        distanceThresh=_FARTHEST,
        mask=mask,
    )
    return make_transform(rotation, translation)


def find_homography(
    first: Floats, second: Floats, threshold_px: float
) -> tuple[Floats, Bools] | None:
    """Homography of pixels (N, 2) in two views, and its inliers; None if undetermined."""
    if len(first) < 8:
        return None
    homography, mask = cv2.findHomography(
        np.ascontiguousarray(first), np.ascontiguousarray(second), cv2.USAC_DEFAULT, threshold_px
    )
    if homography is None or homography.shape != (3, 3):
        return None
    return np.asarray(homography), np.asarray(mask.ravel() > 0)


def motions_of_homography(homography: Floats, matrix: Floats) -> list[Floats]:
    """The up to four second_from_first (4, 4), of unit translation, that a homography allows.

    Source: Malis and Vargas 2007, as in OpenCV. Without translation the list is empty.
    """
    _, rotations, translations, _ = cv2.decomposeHomographyMat(homography, matrix)
    motions = []
    for rotation, translation in zip(rotations, translations, strict=True):
        length = float(np.linalg.norm(translation))
        if length > 1e-9:
            motions.append(make_transform(rotation, translation / length))
    return motions


def fundamental_from_motion(second_from_first: Floats, matrix: Floats) -> Floats:
    """F with x_second^T F x_first = 0 for pixels."""
    essential = skew(second_from_first[:3, 3]) @ second_from_first[:3, :3]
    inverse = np.linalg.inv(matrix)
    return np.asarray(inverse.T @ essential @ inverse)


def epipolar_errors(fundamental: Floats, first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Squared distances (N,) to the epipolar lines in the second and in the first view, px^2."""
    a = np.column_stack([first, np.ones(len(first))])
    b = np.column_stack([second, np.ones(len(second))])
    line_b, line_a = a @ fundamental.T, b @ fundamental
    product = np.sum(b * line_b, axis=1) ** 2
    in_second = product / np.maximum(line_b[:, 0] ** 2 + line_b[:, 1] ** 2, 1e-18)
    in_first = product / np.maximum(line_a[:, 0] ** 2 + line_a[:, 1] ** 2, 1e-18)
    return in_second, in_first


def transfer_errors(homography: Floats, first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Squared transfer errors (N,) of a homography in the second and in the first view, px^2."""
    backwards = np.asarray(np.linalg.inv(homography), dtype=np.float64)
    return _transfer(homography, first, second), _transfer(backwards, second, first)


def _transfer(homography: Floats, source: Floats, target: Floats) -> Floats:
    mapped = np.column_stack([source, np.ones(len(source))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.sum((mapped[:, :2] / mapped[:, 2:] - target) ** 2, axis=1)
    return np.where(np.isfinite(error), error, np.inf)
