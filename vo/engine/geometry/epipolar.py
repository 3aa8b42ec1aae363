"""Essential matrix and homography of two views, with their symmetric errors."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.geometry.projection import Intrinsics, pixel
from vo.base.geometry.transforms import make_transform, skew
from vo.base.types import Bools, Floats

# Maximum depth, in lengths of the translation, of points used in the cheirality check. OpenCV's
# default of 50 excludes all points after a small motion, and the choice of the motion is arbitrary.
_MAX_DEPTH = 1e6


def find_essential(
    first: Floats, second: Floats, matrix: Floats, threshold_px: float
) -> tuple[Floats, Bools] | None:
    """Essential matrix of undistorted pixels (N, 2) in two views, and its inliers (N,).

    None if it is not determined.

    Source: Nister, "An efficient solution to the five-point relative pose problem", 2004, in
        OpenCV's USAC, or plain RANSAC if that fails.
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
    """second_from_first (4, 4), of unit translation, with most points in front of both cameras."""
    mask = inlier.astype(np.uint8)[:, None].copy()
    _, rotation, translation, _, _ = cv2.recoverPose(
        essential,
        np.ascontiguousarray(first),
        np.ascontiguousarray(second),
        np.ascontiguousarray(matrix),
        distanceThresh=_MAX_DEPTH,
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
    """Decompose a homography into up to four second_from_first (4, 4) of unit translation.

    Without translation the list is empty.

    Source: Malis and Vargas, "Deeper understanding of the homography decomposition", 2007, as in
        OpenCV.
    """
    _, rotations, translations, _ = cv2.decomposeHomographyMat(homography, matrix)
    motions = []
    for rotation, translation in zip(rotations, translations, strict=True):
        length = float(np.linalg.norm(translation))
        if length > 1e-9:
            motions.append(make_transform(rotation, translation / length))
    return motions


def fundamental_from_motion(second_from_first: Floats, matrix: Floats) -> Floats:
    """Fundamental matrix F (3, 3), x_second^T F x_first = 0 for homogeneous pixels."""
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


def transferred(homography: Floats, pixels: Floats) -> Floats:
    """Pixels (N, 2) as a homography maps them; not finite on its line at infinity."""
    mapped = np.column_stack([pixels, np.ones(len(pixels))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _transfer(homography: Floats, source: Floats, target: Floats) -> Floats:
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.sum((transferred(homography, source) - target) ** 2, axis=1)
    return np.where(np.isfinite(error), error, np.inf)


# Minimum of d z_second / d z_first - min_depth_ratio for the limit of depth to be computed; below
# it nearly all depths satisfy the ratio, or none.
_MIN_MARGIN = 0.05
_MIN_DEPTH_RATIO = 1e-4  # of a depth in the second view to the farthest in the first


def epipolar_segments(
    xy: Floats,
    second_from_first: Floats,
    nearest: float,
    farthest: float,
    min_depth_ratio: float,
    intrinsics: Intrinsics,
) -> tuple[Floats, Floats, Bools]:
    """Ends of the epipolar segments of pixels.

    Of undistorted pixels (n, 2), for depths from `nearest` to `farthest` in the first view. Where
    the depth in the second is less than `min_depth_ratio` of that, the segment is cut off.

    Returns:
        Undistorted pixels (n, 2) in the second view of the nearest and of the farthest point, and
        a mask (n,). Outside of the mask an end is behind the second camera, and both ends are NaN.
    """
    start, end, possible = _segments(
        np.ascontiguousarray(xy), second_from_first, nearest, farthest, min_depth_ratio, intrinsics
    )
    return start, end, possible


@compiled
def _segments(xy, motion, min_depth, farthest, min_depth_ratio, intrinsics):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = intrinsics
    ends = np.full((2, len(xy), 2), np.nan)
    possible = np.empty(len(xy), dtype=np.bool_)
    for n in range(len(xy)):
        x, y = (xy[n, 0] - cx) / fx, (xy[n, 1] - cy) / fy
        rx = motion[0, 0] * x + motion[0, 1] * y + motion[0, 2]
        ry = motion[1, 0] * x + motion[1, 1] * y + motion[1, 2]
        rz = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2]
        # A point at depth z has the depth rz * z + motion[2, 3] in the second view.
        nearest, margin = min_depth, rz - min_depth_ratio
        if margin > _MIN_MARGIN and motion[2, 3] < 0.0:
            nearest = max(nearest, -motion[2, 3] / margin)
        near_z = rz * nearest + motion[2, 3]
        far_z = rz * farthest + motion[2, 3]
        possible[n] = min(near_z, far_z) > _MIN_DEPTH_RATIO * farthest
        if possible[n]:
            x, y = (rx * nearest + motion[0, 3]) / near_z, (ry * nearest + motion[1, 3]) / near_z
            ends[0, n, 0], ends[0, n, 1] = pixel(intrinsics, x, y, 1.0)
            x, y = (rx * farthest + motion[0, 3]) / far_z, (ry * farthest + motion[1, 3]) / far_z
            ends[1, n, 0], ends[1, n, 1] = pixel(intrinsics, x, y, 1.0)
    return ends[0], ends[1], possible
