"""First guesses: focal length, poses of the board, place of the second camera."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vo.calibrating.adjustment import Sight
from vo.calibrating.projection import Lens, camera_of, see
from vo.errors import CalibrationError
from vo.geometry.cameras import normalise
from vo.types import Floats

_WIDEST_RAY = np.tan(np.deg2rad(75.0))
_FOCAL_SHARES = np.geomspace(0.2, 5.0, 28)
_VIEWS_TO_TRY = 12


def first_intrinsics(
    lens: Lens, sights: Sequence[Sight], points: Floats, size: tuple[int, int]
) -> Floats:
    """The focal length, of many, with which the board's views fit best; the rest as in a textbook.

    Raises:
        CalibrationError: none fits any view.
    """
    tried = sights[:: max(1, len(sights) // _VIEWS_TO_TRY)]
    best, least = None, np.inf
    for share in _FOCAL_SHARES:
        guess = _simple(lens, share * max(size), size)
        poses = [first_pose(lens, guess, sight, points, size) for sight in tried]
        # The median, because a few views at the rim fit no guess.
        errors = [
            _error(lens, guess, pose, sight, points) if pose is not None else np.inf
            for pose, sight in zip(poses, tried, strict=True)
        ]
        if np.median(errors) < least:
            best, least = guess, float(np.median(errors))
    if best is None:
        raise CalibrationError(
            "the corners that were found fit no camera; check --columns, --rows and the images"
        )
    return best


def first_pose(
    lens: Lens, intrinsics: Floats, sight: Sight, points: Floats, size: tuple[int, int]
) -> Floats | None:
    """(6,) rotation vector and translation of cam_from_board; None where there is none."""
    rays = normalise(camera_of(lens, intrinsics, size), sight.xy)
    usable = np.linalg.norm(rays, axis=1) < _WIDEST_RAY  # False where there is no ray
    if np.count_nonzero(usable) < 6:
        return None
    known = points[sight.ids][usable]
    if np.linalg.matrix_rank(known - known[0]) < 2:  # a single row or column has no pose
        return None
    ok, turn, shift = cv2.solvePnP(known, rays[usable], np.eye(3), None)
    pose = np.concatenate([turn, shift]).ravel()
    return pose if ok and np.isfinite(pose).all() and pose[5] > 0 else None


def first_cam1_from_cam0(poses: Sequence[tuple[Floats, Floats]]) -> Floats:
    """(6,) from the poses of the board in both cameras, the median of all views."""
    found = []
    for left, right in poses:
        turn_left, _ = cv2.Rodrigues(left[:3])
        turn_right, _ = cv2.Rodrigues(right[:3])
        turn = turn_right @ turn_left.T
        found.append(np.concatenate([cv2.Rodrigues(turn)[0].ravel(), right[3:] - turn @ left[3:]]))
    return np.asarray(np.median(found, axis=0))


def _simple(lens: Lens, focal: float, size: tuple[int, int]) -> Floats:
    centre = ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    return np.array([focal, focal, *centre, *[0.0] * lens.coefficients])


def _error(lens: Lens, intrinsics: Floats, pose: Floats, sight: Sight, points: Floats) -> float:
    residuals = sight.xy - see(lens, intrinsics, pose, points[sight.ids]).xy
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))
