"""Poses of a calibrated camera relative to the board, one for each view, with their information."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vo.base.geometry.cameras import ideal_pixels
from vo.base.geometry.transforms import inverse, make_transform, skew, so3_exp
from vo.base.types import Camera, Floats, Ints
from vo.tools.calibrating.board import Board
from vo.tools.calibrating.views import DetectedViews

_STEPS, _CONVERGED = 12, 1e-9  # metres and radians
_MIN_CORNERS = 6
_SCALE_PX = 1.0
_MAX_ERROR_PX = 3.0  # RMS; beyond it the view is not that of the board
_FLOOR_PX = 0.03  # of corners


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """Poses of cam0."""

    stamps_ns: Ints  # (N,) increasing
    board_from_cam: Floats  # (N, 4, 4)
    # (N, 6, 6) of a small motion of the camera in its own frame: rotation vector, then translation
    information: Floats
    rms_px: float  # of the corners of all views, after outliers have lost their weight


def board_poses(board: Board, detected: DetectedViews, camera: Camera) -> BoardPoses:
    """Poses of cam0 in all views in which it sees the board well enough."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    stamps, poses, informations, errors = [], [], [], []
    for view in detected.seen_by(0):
        detection = view.detections[0]
        assert detection is not None
        xy = ideal_pixels(camera, detection.xy)
        finite = np.isfinite(xy).all(axis=1)
        if finite.sum() < _MIN_CORNERS:
            continue
        found = _pose(board.points[detection.ids][finite], xy[finite], matrix)
        if found is None or found[2] > _MAX_ERROR_PX:
            continue
        stamps.append(view.stamp_ns)
        poses.append(found[0])
        informations.append(found[1])
        errors.append(found[2])
    rms_px = float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0
    return BoardPoses(
        np.array(stamps, dtype=np.int64),
        np.array(poses).reshape(-1, 4, 4),
        np.array(informations).reshape(-1, 6, 6) / max(rms_px, _FLOOR_PX) ** 2,
        rms_px,
    )


def _pose(points: Floats, xy: Floats, matrix: Floats) -> tuple[Floats, Floats, float] | None:
    """board_from_cam, its information for errors of 1 px, and the RMS error of a coordinate.

    Source: Collins and Bartoli, "Infinitesimal plane-based pose estimation", 2014, in OpenCV.
    """
    count, turns, shifts, _ = cv2.solvePnPGeneric(points, xy, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    best = None
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        start = make_transform(cv2.Rodrigues(turn)[0], shift.ravel())
        found = _refined(inverse(start), points, xy, matrix)
        if best is None or found[2] < best[2]:
            best = found
    return best


def _refined(
    board_from_cam: Floats, points: Floats, xy: Floats, matrix: Floats
) -> tuple[Floats, Floats, float]:
    rotation, position = board_from_cam[:3, :3], board_from_cam[:3, 3]
    information, rms = np.eye(6), np.inf
    for _ in range(_STEPS):
        seen = (points - position) @ rotation
        if seen[:, 2].min() <= 1e-6:
            return board_from_cam, np.eye(6), np.inf
        z = seen[:, 2:]
        error = xy - (seen[:, :2] / z * matrix[[0, 1], [0, 1]] + matrix[:2, 2])
        by_point = np.zeros((len(seen), 2, 3))
        by_point[:, 0, 0], by_point[:, 1, 1] = matrix[0, 0] / z[:, 0], matrix[1, 1] / z[:, 0]
        by_point[:, :, 2] = -seen[:, :2] / z**2 * matrix[[0, 1], [0, 1]]
        # A motion of the camera by (w, t) moves a point by p x w - t in its frame.
        by_motion = np.concatenate([skew(seen), np.tile(-np.eye(3), (len(seen), 1, 1))], 2)
        jacobian = by_point @ by_motion
        weight = 1.0 / (1.0 + np.sum(error**2, axis=1) / _SCALE_PX**2)
        information = np.einsum("nki,n,nkj->ij", jacobian, weight, jacobian)
        gradient = np.einsum("nki,n,nk->i", jacobian, weight, error)
        step = np.linalg.lstsq(information, gradient, rcond=1e-12)[0]
        position = position + rotation @ step[3:]
        rotation = rotation @ so3_exp(step[:3])
        rms = float(np.sqrt(np.average(np.mean(error**2, axis=1), weights=weight)))
        if np.abs(step).max() < _CONVERGED:
            break
    return make_transform(rotation, position), information, rms
