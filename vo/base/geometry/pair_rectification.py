"""Rectified cameras of a stereo pair: any rotation between the two, any direction of the baseline.

Pairs that are mounted side by side, as most are, are rectified by OpenCV or by turning both cameras
half-way. For others, such as one camera above the other, or one upside down, OpenCV exchanges rows
and columns or mirrors the images: their rectified cameras are built here from the baseline alone.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry import cameras
from vo.base.geometry.distortion import centre_scale
from vo.base.geometry.rectification_maps import Maps, narrow_maps, wide_maps
from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Camera, Floats

# A pair is side by side if its baseline is this near to the x axis of cam0, and the rotation
# between the cameras this small.
_MAX_SIDEWAYS_DEG = 30.0
# Minimum angle between the baseline and the direction in which the cameras look: rectified cameras
# look across the baseline, and have little of the recorded images in view at smaller ones.
_MIN_ANGLE_DEG = 30.0
# Minimum ratio of the rectified image that both cameras see at infinity.
_MIN_OVERLAP = 0.15
_OVERLAP_STEP_PX = 8


class RectifiedPair(NamedTuple):
    """Rectified cameras of a pair; both have the same intrinsics.

    Attributes:
        size: width and height of the rectified images.
        matrix: (3, 3) camera matrix.
        baseline_m: distance from the left to the right camera, along x.
        rectified_from_cam: rotations (3, 3) of cam0 and cam1.
        maps: rectification maps of cam0 and cam1.
    """

    size: tuple[int, int]
    matrix: Floats
    baseline_m: float
    rectified_from_cam: tuple[Floats, Floats]
    maps: tuple[Maps, Maps]


def rectify_pair(a: Camera, b: Camera, cam1_from_cam0: Floats) -> RectifiedPair:
    """Choose rectified cameras for cam0 and cam1, and compute their maps.

    The x axis of the rectified cameras is the baseline. Unless the pair is side by side, it is
    directed from cam0 to cam1, wherever in the image that is: to the right, down, left or up.

    Raises:
        CalibrationError: the cameras are at the same place, one in front of the other, or have too
            little of the scene in common.
    """
    check_baseline(cam1_from_cam0)
    if _is_side_by_side(cam1_from_cam0):
        pair = _side_by_side(a, b, cam1_from_cam0)
    else:
        pair = _along_baseline(a, b, cam1_from_cam0)
    _check_overlap(a, b, cam1_from_cam0, pair)
    return pair


def is_wide(camera: Camera) -> bool:
    """Whether OpenCV's `stereoRectify` does not support the lens model."""
    return camera.distortion_model not in ("none", "radtan")


def central_focal(camera: Camera) -> tuple[float, float]:
    """Focal lengths of the pinhole camera with the same magnification on the axis."""
    scale = centre_scale(camera)
    return scale * camera.fx, scale * camera.fy


def check_baseline(cam1_from_cam0: Floats) -> None:
    """Check that the cameras are apart, and not one in front of the other.

    Raises:
        CalibrationError: they are not.
    """
    cam1_in_cam0 = inverse(cam1_from_cam0)[:3, 3]
    length = float(np.linalg.norm(cam1_in_cam0))
    if not length > 0.0:
        raise CalibrationError(
            "cam0 and cam1 are at the same place (a baseline of 0 m); check cam1_from_cam0, or use "
            "`mode=mono`"
        )
    view = _mean_view(cam1_from_cam0)
    along = float(cam1_in_cam0 @ view) / length
    if abs(along) > np.cos(np.deg2rad(_MIN_ANGLE_DEG)):
        where = "in front of" if along > 0 else "behind"
        raise CalibrationError(
            f"cam1 is {abs(along) * length:.4g} m {where} cam0, along its optical axis; a stereo "
            "pair needs cameras beside or above each other: check cam1_from_cam0, or use "
            "`mode=mono`"
        )


def _mean_view(cam1_from_cam0: Floats) -> Floats:
    """Mean direction (3,) of both optical axes in cam0, that of cam0 if they are opposite."""
    view = np.array([0.0, 0.0, 1.0]) + cam1_from_cam0[2, :3]
    length = float(np.linalg.norm(view))
    return np.asarray(view / length) if length > 1e-6 else np.array([0.0, 0.0, 1.0])


def _is_side_by_side(cam1_from_cam0: Floats) -> bool:
    """Whether cam1 is to the right of cam0, and turned little."""
    cam1_in_cam0 = inverse(cam1_from_cam0)[:3, 3]
    sideways = float(cam1_in_cam0[0] / np.linalg.norm(cam1_in_cam0))
    turn = float(np.linalg.norm(cv2.Rodrigues(cam1_from_cam0[:3, :3].copy())[0]))
    limit = np.deg2rad(_MAX_SIDEWAYS_DEG)
    return bool(sideways >= np.cos(limit) and turn <= limit)


def _side_by_side(a: Camera, b: Camera, cam1_from_cam0: Floats) -> RectifiedPair:
    size = (a.width, a.height)
    rotation, translation = cam1_from_cam0[:3, :3].copy(), cam1_from_cam0[:3, 3:4].copy()
    if is_wide(a) or is_wide(b):
        r0, r1, p0, p1 = _half_way(a, b, rotation, translation)
        maps = (wide_maps(a, r0, p0, size), wide_maps(b, r1, p1, size))
    else:
        r0, r1, p0, p1 = cv2.stereoRectify(
            a.matrix,
            np.array(a.distortion),
            b.matrix,
            np.array(b.distortion),
            size,
            rotation,
            translation,
            flags=cv2.CALIB_ZERO_DISPARITY,
            alpha=0.0,
        )[:4]
        maps = (narrow_maps(a, r0, p0, size), narrow_maps(b, r1, p1, size))
    baseline = -float(p1[0, 3] / p1[0, 0])
    return RectifiedPair(size, np.asarray(p0[:, :3]), baseline, (r0, r1), maps)


def _half_way(
    a: Camera, b: Camera, rotation: Floats, translation: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Rotate both cameras half-way towards each other, then align x with the baseline.

    OpenCV's fisheye version chooses focal lengths that crop the image to a small part. Here both
    cameras get the mean focal length (on the axis) and principal point of the recorded ones: 100
    to 120 degrees of a usual fisheye, nowhere reduced in size.

    Returns:
        Rotations (3, 3) of both cameras and projections (3, 4), as `cv2.stereoRectify`.

    Source: Fusiello et al., "A compact algorithm for rectification of stereo pairs", 2000.
    """
    half, _ = cv2.Rodrigues(-0.5 * cv2.Rodrigues(rotation)[0])
    along = (half @ translation).reshape(3)
    x = -along / np.linalg.norm(along)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    turn = np.stack([x, y, np.cross(x, y)])
    focal = float(np.mean([*central_focal(a), *central_focal(b)]))
    p0 = np.array(
        [
            [focal, 0.0, 0.5 * (a.cx + b.cx), 0.0],
            [0.0, focal, 0.5 * (a.cy + b.cy), 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    p1 = p0.copy()
    p1[0, 3] = -focal * float(np.linalg.norm(translation))
    return turn @ half.T, turn @ half, p0, p1


def _along_baseline(a: Camera, b: Camera, cam1_from_cam0: Floats) -> RectifiedPair:
    """Cameras with x from cam0 to cam1 that look, across it, in the mean direction of both.

    The image is as high as wide as recorded, or the other way round if it is turned by about 90
    degrees; the focal length is the mean of the recorded ones, and what both cameras see in the
    middle of their images is, on average, in the middle.
    """
    cam1_in_cam0 = inverse(cam1_from_cam0)[:3, 3]
    baseline = float(np.linalg.norm(cam1_in_cam0))
    x = cam1_in_cam0 / baseline
    z = _mean_view(cam1_from_cam0)
    z = z - (z @ x) * x
    z /= np.linalg.norm(z)
    r0 = np.stack([x, np.cross(z, x), z])
    r1 = r0 @ cam1_from_cam0[:3, :3].T
    is_upright = abs(r0[0, 0]) >= abs(r0[0, 1])
    size = (a.width, a.height) if is_upright else (a.height, a.width)
    focal = float(np.mean([*central_focal(a), *central_focal(b)]))
    shift = focal * 0.5 * (_middle(a, r0) + _middle(b, r1))
    cx, cy = 0.5 * (np.array(size) - 1.0) - shift
    matrix = np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]])
    maps = (wide_maps(a, r0, matrix, size), wide_maps(b, r1, matrix, size))
    return RectifiedPair(size, matrix, baseline, (r0, r1), maps)


def _middle(camera: Camera, rectified_from_cam: Floats) -> Floats:
    """Normalised rectified image point (2,) of the middle of a recorded image.

    Zero, the axis of the rectified camera, if that camera looks elsewhere.
    """
    size = np.array([camera.width, camera.height])
    seen = cameras.normalise(camera, 0.5 * (size[None] - 1.0))[0]
    ray = rectified_from_cam @ (*np.nan_to_num(seen), 1.0)
    return np.asarray(ray[:2] / ray[2]) if ray[2] > 0.1 else np.zeros(2)


def _check_overlap(a: Camera, b: Camera, cam1_from_cam0: Floats, pair: RectifiedPair) -> None:
    """Check that rectification has succeeded, and that both cameras see the same scene."""
    focal = min(pair.matrix[0, 0], pair.matrix[1, 1])
    overlap = float((_seen(a, pair.maps[0]) & _seen(b, pair.maps[1])).mean())
    if overlap >= _MIN_OVERLAP and focal > 0.0 and pair.baseline_m > 0.0:
        return
    cosine = np.clip(cam1_from_cam0[2, 2], -1.0, 1.0)  # of the angle between the optical axes
    raise CalibrationError(
        f"cam0 and cam1 look {np.rad2deg(np.arccos(cosine)):.0f}° apart: after rectification only "
        f"{overlap:.0%} of the image is seen by both; check cam1_from_cam0, or use `mode=mono`"
    )


def _seen(camera: Camera, maps: Maps) -> Bools:
    """Which pixels of a rectified image, on a coarse grid, a camera sees."""
    xy = maps[0][::_OVERLAP_STEP_PX, ::_OVERLAP_STEP_PX]
    return np.asarray(((xy >= 0) & (xy < (camera.width, camera.height))).all(axis=2))
