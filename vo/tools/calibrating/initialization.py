"""Initial values: focal length, poses of the board, pose of the second camera."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import normalise
from vo.base.types import Floats
from vo.tools.calibrating.bundle_adjustment import Observation, rms
from vo.tools.calibrating.projection import LensModel, camera_of, project

_MAX_RAY = np.tan(np.deg2rad(75.0))
_FOCAL_RATIOS = np.geomspace(0.2, 5.0, 28)
"""Focal lengths to try, relative to the longer side of the image."""

_VIEWS_TO_TRY = 12
_MIN_POINTS = 6


def initial_intrinsics(
    lens: LensModel, observations: Sequence[Observation], points: Floats, size: tuple[int, int]
) -> Floats:
    """Intrinsics with the focal length that fits the views best, without distortion.

    The principal point is the centre of the image.

    Raises:
        CalibrationError: no focal length fits half of the views.
    """
    tried = observations[:: max(1, len(observations) // _VIEWS_TO_TRY)]
    best, min_error = None, np.inf
    for ratio in _FOCAL_RATIOS:
        guess = _ideal_intrinsics(lens, ratio * max(size), size)
        poses = [initial_pose(lens, guess, observation, points, size) for observation in tried]
        # The median, because a few views near the border fit no focal length.
        errors = [
            _reprojection_rms(lens, guess, pose, observation, points)
            if pose is not None
            else np.inf
            for pose, observation in zip(poses, tried, strict=True)
        ]
        if np.median(errors) < min_error:
            best, min_error = guess, float(np.median(errors))
    if best is None:
        raise CalibrationError(
            "no camera fits the detected corners; check `columns`, `rows` and the images"
        )
    return best


def initial_pose(
    lens: LensModel,
    intrinsics: Floats,
    observation: Observation,
    points: Floats,
    size: tuple[int, int],
) -> Floats | None:
    """(6,) rotation vector and translation of cam_from_board; None if it is not determined."""
    rays = normalise(camera_of(lens, intrinsics, size), observation.xy)
    usable = np.linalg.norm(rays, axis=1) < _MAX_RAY  # False for NaN, pixels without a ray
    if np.count_nonzero(usable) < _MIN_POINTS:
        return None
    known = points[observation.ids][usable]
    if np.linalg.matrix_rank(known - known[0]) < 2:  # a single row or column has no pose
        return None
    ok, turn, shift = cv2.solvePnP(known, rays[usable], np.eye(3), None)
    pose = np.concatenate([turn, shift]).ravel()
    return pose if ok and np.isfinite(pose).all() and pose[5] > 0 else None


def initial_cam1_from_cam0(poses: Sequence[tuple[Floats, Floats]]) -> Floats:
    """(6,) median over all views, from the poses of the board in both cameras."""
    found = []
    for left, right in poses:
        left_rotation, _ = cv2.Rodrigues(left[:3])
        right_rotation, _ = cv2.Rodrigues(right[:3])
        rotation = right_rotation @ left_rotation.T
        translation = right[3:] - rotation @ left[3:]
        found.append(np.concatenate([cv2.Rodrigues(rotation)[0].ravel(), translation]))
    return np.asarray(np.median(found, axis=0))


def _ideal_intrinsics(lens: LensModel, focal: float, size: tuple[int, int]) -> Floats:
    centre = ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    return np.array([focal, focal, *centre, *[0.0] * lens.coefficients])


def _reprojection_rms(
    lens: LensModel, intrinsics: Floats, pose: Floats, observation: Observation, points: Floats
) -> float:
    return rms([observation.xy - project(lens, intrinsics, pose, points[observation.ids]).xy])
