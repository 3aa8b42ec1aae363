"""Warnings about the quality of a calibration, with advice."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.types import Bools, Floats
from vo.tools.calibrating.board import Board
from vo.tools.calibrating.calibrate import CalibrationResult

_MIN_VIEWS = 15
_GRID = (8, 6)
_EDGE = 2
_MIN_COVERAGE = 0.25
_TILTED_DEG = 15.0
_MIN_TILTED = 0.3
_MAX_RMS_PX = 0.5
_MAX_EPIPOLAR_PX = 0.5
_MAX_FOCAL_SIGMA = 0.002  # relative
_MAX_OFF_CENTRE = 0.1  # relative to the image size
_USUAL_WIDTHS_M = (0.06, 1.5)
_MAX_PAIR_ERROR_RATIO = 2.0
_MIN_PAIR_ERROR_PX = 0.2
_SIDES = ("left", "right")


def warnings_of(result: CalibrationResult) -> list[str]:
    """One line for each weakness of the calibration, the most important first."""
    lines = _pair_warnings(result)
    cameras = result.detected.cameras
    for camera in range(cameras):
        whose = "" if cameras == 1 else f"{_SIDES[camera]} camera: "
        lines += [f"{whose}{line}" for line in _camera_warnings(result, camera)]
    return lines + _board_warnings(result.board)


def _board_warnings(board: Board) -> list[str]:
    width_m = (board.columns + 1) * board.square_m
    if _USUAL_WIDTHS_M[0] <= width_m <= _USUAL_WIDTHS_M[1]:
        return []
    return [
        f"the board would be {width_m:.3g} m wide, with squares of {1000 * board.square_m:g} mm: "
        "`square_m` is in metres, 0.03 for 30 mm; an error of it scales the baseline too"
    ]


def coverage(result: CalibrationResult, camera: int) -> Bools:
    """(6, 8) cells of the image in which a corner of the board was detected."""
    columns, rows = _GRID
    covered = np.zeros((rows, columns), dtype=np.bool_)
    for observation, _ in result.observations_of(camera):
        cells = (observation.xy / result.size * _GRID).astype(int)
        covered[np.clip(cells[:, 1], 0, rows - 1), np.clip(cells[:, 0], 0, columns - 1)] = True
    return covered


def tilts_deg(result: CalibrationResult, camera: int) -> Floats:
    """Angle between board and image plane in each view, in degrees."""
    parameters = result.fit.adjustment.parameters
    turn = np.eye(3)
    if camera == 1 and parameters.cam1_from_cam0 is not None:
        turn, _ = cv2.Rodrigues(parameters.cam1_from_cam0[:3])
    views = [observation.view for observation, _ in result.observations_of(camera)]
    normals = [abs((turn @ cv2.Rodrigues(parameters.poses[view][:3])[0])[2, 2]) for view in views]
    return np.asarray(np.rad2deg(np.arccos(np.clip(normals, 0.0, 1.0))))


def _camera_warnings(result: CalibrationResult, camera: int) -> list[str]:
    lines = []
    observations = result.observations_of(camera)
    if len(observations) < _MIN_VIEWS:
        lines.append(f"only {len(observations)} views; {_MIN_VIEWS} to 40 are better")
    tilts = tilts_deg(result, camera)
    tilted = float(np.mean(tilts > _TILTED_DEG))
    if tilted < _MIN_TILTED:
        lines.append(
            f"only {tilted:.0%} of the views are tilted by more than {_TILTED_DEG:g} degrees, so "
            "the focal length is poorly determined; tilt the board by 30 to 45 degrees in all "
            "directions"
        )
    lines += _coverage_warnings(coverage(result, camera))
    known, sigma = (
        each.intrinsics[camera]
        for each in (result.fit.adjustment.parameters, result.fit.adjustment.sigmas)
    )
    if sigma[0] > _MAX_FOCAL_SIGMA * known[0]:
        lines.append(
            f"the focal length is uncertain: {known[0]:.1f} ± {sigma[0]:.2g} px; add near and "
            "tilted views"
        )
    error = float(np.sqrt(np.mean(np.concatenate([np.sum(r**2, axis=1) for _, r in observations]))))
    if error > _MAX_RMS_PX:
        lines.append(
            f"the error is {error:.2f} px (RMS), 0.1 to 0.3 is usual: blurred images, motion with "
            "a rolling shutter, a board that is not flat, or the wrong lens model (`model`)"
        )
    off = np.abs(known[2:4] - (np.array(result.size) - 1) / 2) / result.size
    if off.max() > _MAX_OFF_CENTRE:
        lines.append(
            f"the principal point ({known[2]:.0f}, {known[3]:.0f}) is far from the image centre; "
            "plausible only for cropped images"
        )
    return lines


def _coverage_warnings(covered: Bools) -> list[str]:
    places = {
        "left edge": covered[:, :_EDGE],
        "right edge": covered[:, -_EDGE:],
        "top edge": covered[:_EDGE],
        "bottom edge": covered[-_EDGE:],
        "top left corner": covered[:_EDGE, :_EDGE],
        "top right corner": covered[:_EDGE, -_EDGE:],
        "bottom left corner": covered[-_EDGE:, :_EDGE],
        "bottom right corner": covered[-_EDGE:, -_EDGE:],
    }
    bare = [name for name, part in places.items() if part.mean() < _MIN_COVERAGE]
    edges = [name for name in bare if "edge" in name]
    if not bare:
        return []
    return [
        f"hardly any corners at the {', '.join(edges or bare)} of the image, where the distortion "
        "is extrapolated; hold the board there too"
    ]


def _pair_warnings(result: CalibrationResult) -> list[str]:
    transform = result.rig.cam1_from_cam0
    if transform is None:
        return []
    lines = []
    pairs = len(result.epipolar_px)
    if pairs < _MIN_VIEWS:
        lines.append(
            f"only {pairs} views show the board to both cameras; {_MIN_VIEWS} or more are better"
        )
    error = float(np.sqrt(np.mean([value**2 for _, value in result.epipolar_px])))
    together = result.fit.adjustment.rms_px
    alone = max(
        errors[lens.name]
        for errors, lens in zip(result.compared_rms_px, result.fit.lenses, strict=True)
    )
    if error > _MAX_EPIPOLAR_PX or together > max(
        _MAX_PAIR_ERROR_RATIO * alone, _MIN_PAIR_ERROR_PX
    ):
        lines.append(
            f"the error is {together:.2f} px with both cameras, {alone:.2f} px with one alone, and "
            f"{error:.2f} px from epipolar lines: check that both cameras expose at the same "
            "moment, and hold the board still"
        )
    right_of_left = -(transform[:3, :3].T @ transform[:3, 3])
    if right_of_left[0] < 0.5 * np.linalg.norm(right_of_left):
        lines.append(
            "cam1 is not to the right of cam0: unless the cameras are mounted so, left and right "
            "are swapped (`topics=left=… right=…`), or the images are mirrored"
        )
    return lines
