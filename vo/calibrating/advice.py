"""What a calibration lacks, and what to do about it."""

from __future__ import annotations

import cv2
import numpy as np

from vo.calibrating.board import Board
from vo.calibrating.calibrate import Result
from vo.types import Bools, Floats

_FEW_VIEWS = 15
_GRID = (8, 6)
_EDGE = 2
_BARE = 0.25
_TILTED_DEG = 15.0
_FEW_TILTED = 0.3
_LARGE_RMS_PX = 0.5
_LARGE_EPIPOLAR_PX = 0.5
_UNSURE_FOCAL = 0.002
_FAR_OFF_CENTRE = 0.1
_WIDTHS_M = (0.06, 1.5)
_LARGE_TOGETHER = 2.0
_LEAST_TOGETHER_PX = 0.2
_SIDES = ("left", "right")


def warnings_of(result: Result) -> list[str]:
    """One line for each thing that makes the calibration poor, most important first."""
    lines = _of_pair(result)
    cameras = result.survey.cameras
    for camera in range(cameras):
        whose = "" if cameras == 1 else f"{_SIDES[camera]} camera: "
        lines += [f"{whose}{line}" for line in _of_camera(result, camera)]
    return lines + _of_board(result.board)


def _of_board(board: Board) -> list[str]:
    width_m = (board.columns + 1) * board.square_m
    if _WIDTHS_M[0] <= width_m <= _WIDTHS_M[1]:
        return []
    return [
        f"the board would be {width_m:.3g} m wide, with squares of {1000 * board.square_m:g} mm: "
        "--square is in metres, 0.03 for 30 mm; the baseline is wrong by the same factor"
    ]


def coverage(result: Result, camera: int) -> Bools:
    """(6, 8) which parts of the image had a corner of the board in them."""
    columns, rows = _GRID
    counts = np.zeros((rows, columns), dtype=np.bool_)
    for sight, _ in result.sights_of(camera):
        cells = (sight.xy / result.size * _GRID).astype(int)
        counts[np.clip(cells[:, 1], 0, rows - 1), np.clip(cells[:, 0], 0, columns - 1)] = True
    return counts


def tilts_deg(result: Result, camera: int) -> Floats:
    """Angle of the board of each view out of the image plane, in degrees."""
    unknowns = result.fit.adjusted.unknowns
    turn = np.eye(3)
    if camera == 1 and unknowns.cam1_from_cam0 is not None:
        turn, _ = cv2.Rodrigues(unknowns.cam1_from_cam0[:3])
    views = [sight.view for sight, _ in result.sights_of(camera)]
    normals = [abs((turn @ cv2.Rodrigues(unknowns.poses[view][:3])[0])[2, 2]) for view in views]
    return np.asarray(np.rad2deg(np.arccos(np.clip(normals, 0.0, 1.0))))


def _of_camera(result: Result, camera: int) -> list[str]:
    lines = []
    sights = result.sights_of(camera)
    if len(sights) < _FEW_VIEWS:
        lines.append(f"only {len(sights)} views; {_FEW_VIEWS} to 40 make it sure")
    tilts = tilts_deg(result, camera)
    tilted = float(np.mean(tilts > _TILTED_DEG))
    if tilted < _FEW_TILTED:
        lines.append(
            f"the board faces the camera in nearly all views ({tilted:.0%} are tilted by more than "
            f"{_TILTED_DEG:g} degrees), so that the focal length is poorly determined; tilt it by "
            "30 to 45 degrees, every way"
        )
    lines += _of_coverage(coverage(result, camera))
    known, sigma = (
        each.intrinsics[camera]
        for each in (result.fit.adjusted.unknowns, result.fit.adjusted.sigmas)
    )
    if sigma[0] > _UNSURE_FOCAL * known[0]:
        lines.append(
            f"the focal length is only known to {sigma[0]:.2g} of {known[0]:.1f} px; add views, "
            "tilted and near"
        )
    error = float(np.sqrt(np.mean(np.concatenate([np.sum(r**2, axis=1) for _, r in sights]))))
    if error > _LARGE_RMS_PX:
        lines.append(
            f"corners are off by {error:.2f} px (RMS), where 0.1 to 0.3 is usual: images unsharp "
            "or bent by motion (rolling shutter), a board that is not flat, or a lens of another "
            "kind (--model)"
        )
    off = np.abs(known[2:4] - (np.array(result.size) - 1) / 2) / result.size
    if off.max() > _FAR_OFF_CENTRE:
        lines.append(
            f"the principal point ({known[2]:.0f}, {known[3]:.0f}) is far from the middle of the "
            "image; right only if the images are cropped"
        )
    return lines


def _of_coverage(seen: Bools) -> list[str]:
    places = {
        "left edge": seen[:, :_EDGE],
        "right edge": seen[:, -_EDGE:],
        "top edge": seen[:_EDGE],
        "bottom edge": seen[-_EDGE:],
        "top left corner": seen[:_EDGE, :_EDGE],
        "top right corner": seen[:_EDGE, -_EDGE:],
        "bottom left corner": seen[-_EDGE:, :_EDGE],
        "bottom right corner": seen[-_EDGE:, -_EDGE:],
    }
    bare = [name for name, part in places.items() if part.mean() < _BARE]
    edges = [name for name in bare if "edge" in name]
    if not bare:
        return []
    return [
        f"hardly a corner of the board at the {', '.join(edges or bare)} of the image, where the "
        "lens is guessed: hold the board there too"
    ]


def _of_pair(result: Result) -> list[str]:
    transform = result.rig.cam1_from_cam0
    if transform is None:
        return []
    lines = []
    pairs = len(result.epipolar_px)
    if pairs < _FEW_VIEWS:
        lines.append(f"only {pairs} views show the board to both cameras; {_FEW_VIEWS} and more")
    error = float(np.sqrt(np.mean([value**2 for _, value in result.epipolar_px])))
    together = result.fit.adjusted.rms_px
    alone = max(
        errors[lens.name] for errors, lens in zip(result.compared, result.fit.lenses, strict=True)
    )
    if error > _LARGE_EPIPOLAR_PX or together > max(_LARGE_TOGETHER * alone, _LEAST_TOGETHER_PX):
        lines.append(
            f"corners are off by {together:.2f} px in both cameras together, by {alone:.2f} px in "
            f"one alone, and by {error:.2f} px from epipolar lines: check that both take their "
            "images at the same moment, and hold the board still"
        )
    right_of_left = -(transform[:3, :3].T @ transform[:3, 3])
    if right_of_left[0] < 0.5 * np.linalg.norm(right_of_left):
        lines.append(
            "cam1 is not to the right of cam0: left and right are swapped (--topic left=… "
            "right=…), or the images are mirrored; vo run will refuse the pair"
        )
    return lines
