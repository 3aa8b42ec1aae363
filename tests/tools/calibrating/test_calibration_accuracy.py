"""Accuracy of the calibration of known cameras from rendered images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_images import poses_around, render

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import distort, normalise
from vo.base.geometry.transforms import inverse, make_transform, rotation_angle, so3_exp
from vo.base.types import Camera, Floats, Frame
from vo.tools.calibrating.advice import warnings_of
from vo.tools.calibrating.board import Board, make_board
from vo.tools.calibrating.bundle_adjustment import Observation
from vo.tools.calibrating.calibrate import CalibrationResult, calibrate
from vo.tools.calibrating.initialization import initial_pose
from vo.tools.calibrating.projection import LENS_MODELS
from vo.tools.calibrating.views import detect_views

SIZE = (480, 360)
RADTAN = Camera(*SIZE, 343.0, 342.0, 247.0, 186.0, "radtan", (-0.28, 0.074, 2e-4, 2e-5))
FISHEYE = Camera(*SIZE, 190.0, 189.0, 242.0, 177.0, "equidistant", (-0.01, 0.02, -0.008, 0.001))
CHESSBOARD = make_board("chessboard", 8, 5, 0.03)
CHARUCO = make_board("charuco", 7, 5, 0.03)
CAM1_FROM_CAM0 = make_transform(so3_exp(np.array([0.01, -0.02, 0.005])), np.array([-0.1, 2e-3, 0]))


def recorded(board: Board, cameras: Sequence[Camera], poses: Sequence[Floats]) -> list[Frame]:
    """A frame for each pose of the board in cam0."""
    return [
        Frame(
            i,
            i * 10**8,
            (
                render(board, cameras[0], pose),
                *(render(board, camera, CAM1_FROM_CAM0 @ pose) for camera in cameras[1:]),
            ),
        )
        for i, pose in enumerate(poses)
    ]


def calibrated(
    board: Board, *cameras: Camera, count: int = 22, model: str = "auto"
) -> CalibrationResult:
    frames = recorded(board, cameras, poses_around(board, cameras[0], count))
    return calibrate(board, detect_views(board, frames, len(cameras), threads=2), SIZE, model)


def assert_alike(found: Camera | None, true: Camera, board: Board) -> None:
    # Corners of the image contain no chessboard, as it must be completely visible.
    reach = 0.8 if board.kind == "chessboard" else 1.0
    assert found is not None
    assert found.distortion_model == true.distortion_model
    assert found.fx == pytest.approx(true.fx, rel=0.002)
    assert found.fy == pytest.approx(true.fy, rel=0.002)
    assert found.cx == pytest.approx(true.cx, abs=1.0)
    assert found.cy == pytest.approx(true.cy, abs=1.0)
    assert field_difference_px(found, true, reach).max() < 0.3


def field_difference_px(found: Camera, true: Camera, reach: float) -> Floats:
    """Distances between projections of the same rays, after the best rotation of the camera.

    An error of the principal point is nearly equivalent to a rotation of the camera, for which the
    board poses compensate. `reach` limits the region, relative to the corners of the image.
    """
    u, v = np.meshgrid(np.arange(0, SIZE[0], 12.0), np.arange(0, SIZE[1], 12.0))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    middle = np.array(SIZE) / 2
    pixels = pixels[np.linalg.norm(pixels - middle, axis=1) < reach * np.linalg.norm(middle)]
    rays = np.column_stack([normalise(true, pixels), np.ones(len(pixels))])

    def difference(turn: Floats) -> Floats:
        turned = rays @ so3_exp(turn).T
        return (distort(found, turned[:, :2] / turned[:, 2:]) - pixels).ravel()

    turn = np.zeros(3)
    for _ in range(3):
        now = difference(turn)
        slopes = [(difference(turn + step) - now) / 1e-6 for step in 1e-6 * np.eye(3)]
        turn = turn - np.linalg.lstsq(np.stack(slopes, axis=1), now, rcond=None)[0]
    return np.asarray(np.linalg.norm(difference(turn).reshape(-1, 2), axis=1))


@pytest.mark.parametrize(
    ("board", "camera"), [(CHARUCO, RADTAN), (CHESSBOARD, FISHEYE)], ids=["charuco", "chessboard"]
)
def test_one_camera(board: Board, camera: Camera) -> None:
    result = calibrated(board, camera)
    assert_alike(result.rig.cam0, camera, board)
    assert result.rig.cam1 is None
    assert result.fit.adjustment.rms_px < 0.1


@pytest.mark.parametrize(
    ("board", "camera"), [(CHESSBOARD, RADTAN), (CHARUCO, FISHEYE)], ids=["chessboard", "charuco"]
)
def test_a_pair(board: Board, camera: Camera) -> None:
    right = replace(camera, fx=1.01 * camera.fx, cx=camera.cx - 4.0)
    result = calibrated(board, camera, right)
    assert_alike(result.rig.cam0, camera, board)
    assert result.rig.cam1 is not None and result.rig.cam1_from_cam0 is not None
    assert result.rig.cam1.fx == pytest.approx(right.fx, rel=0.002)
    found = result.rig.cam1_from_cam0
    length = np.linalg.norm(CAM1_FROM_CAM0[:3, 3])
    assert np.linalg.norm(found[:3, 3]) == pytest.approx(length, rel=0.005)
    error = inverse(CAM1_FROM_CAM0) @ found
    assert np.rad2deg(rotation_angle(error[:3, :3])) < 0.05
    assert max(miss for _, miss in result.epipolar_px) < 0.2


def test_errors_are_within_the_standard_deviations() -> None:
    result = calibrated(CHESSBOARD, FISHEYE, count=16, model="equidistant")
    known, sigmas = result.fit.adjustment.parameters, result.fit.adjustment.sigmas
    true = np.array([FISHEYE.fx, FISHEYE.fy, FISHEYE.cx, FISHEYE.cy, *FISHEYE.distortion])
    assert np.all(np.abs(known.intrinsics[0] - true) < 6.0 * sigmas.intrinsics[0])
    assert np.all(sigmas.intrinsics[0][:2] < 0.1)


def test_an_outlier_view_is_dropped() -> None:
    poses = poses_around(CHARUCO, RADTAN, 16)
    frames = recorded(CHARUCO, [RADTAN], poses)
    # A frame from another camera: the same scene a tenth larger along one axis.
    stretched = np.repeat(frames[5].image0, 2, axis=1)[:, : 2 * SIZE[0] : 2]
    bent = np.roll(stretched, 1, axis=0)
    bent[:, SIZE[0] // 2 :] = np.roll(bent[:, SIZE[0] // 2 :], 3, axis=0)
    frames[5] = replace(frames[5], images=(bent, *frames[5].images[1:]))
    result = calibrate(CHARUCO, detect_views(CHARUCO, frames, 1, 2), SIZE, "radtan")
    assert 5 in {frame for frame, _ in result.fit.dropped}
    assert result.rig.cam0.fx == pytest.approx(RADTAN.fx, rel=0.004)


def test_missing_tilt_is_a_warning() -> None:
    poses = [make_transform(np.eye(3), np.array([-0.12, -0.09, 0.3 + 0.03 * i])) for i in range(8)]
    result = calibrate(
        CHARUCO, detect_views(CHARUCO, recorded(CHARUCO, [RADTAN], poses), 1, 2), SIZE
    )
    lines = warnings_of(result)
    assert any("views; 15 to 40" in line for line in lines)
    assert any("focal length is poorly determined" in line for line in lines)


def test_the_result_does_not_depend_on_the_number_of_threads() -> None:
    frames = recorded(CHARUCO, [RADTAN], poses_around(CHARUCO, RADTAN, 6))
    first, second = (
        calibrate(CHARUCO, detect_views(CHARUCO, frames, 1, threads), SIZE, "radtan")
        for threads in (1, 3)
    )
    assert first.rig.cam0 == second.rig.cam0


def test_a_single_row_of_corners_has_no_pose() -> None:
    lens, intrinsics = LENS_MODELS[0], np.array([343.0, 342.0, 247.0, 186.0, 0.0, 0.0, 0.0, 0.0])
    row = np.arange(7)
    observation = Observation(0, 0, row, np.column_stack([100.0 + 30.0 * row, 50.0 + 0.2 * row**2]))
    assert initial_pose(lens, intrinsics, observation, CHARUCO.points, SIZE) is None


def test_a_pair_that_is_not_synchronised_is_refused() -> None:
    poses = poses_around(CHARUCO, RADTAN, 14)
    frames = recorded(CHARUCO, [RADTAN, RADTAN], poses)
    # The board moves by a few centimetres between the left and the right image.
    rng = np.random.default_rng(1)
    later = [make_transform(np.eye(3), rng.uniform(-0.02, 0.02, 3)) @ pose for pose in poses]
    late = [
        replace(frame, images=(frame.image0, render(CHARUCO, RADTAN, CAM1_FROM_CAM0 @ pose)))
        for frame, pose in zip(frames, later, strict=True)
    ]
    found = detect_views(CHARUCO, late, 2, threads=2)
    with pytest.raises(CalibrationError, match="at the same moment"):
        calibrate(CHARUCO, found, SIZE, "radtan")


def test_swapped_cameras_are_a_warning() -> None:
    frames = recorded(CHARUCO, [RADTAN, RADTAN], poses_around(CHARUCO, RADTAN, 12))
    swapped = [replace(f, images=f.images[::-1]) for f in frames if f.image1 is not None]
    result = calibrate(CHARUCO, detect_views(CHARUCO, swapped, 2, threads=2), SIZE, "radtan")
    assert any("left and right are swapped" in line for line in warnings_of(result))


def test_standard_deviations_equal_those_of_opencv() -> None:
    result = calibrated(CHARUCO, RADTAN, count=14, model="radtan")
    observations = [observation for observation, _ in result.observations_of(0)]
    points = [CHARUCO.points[observation.ids].astype(np.float32) for observation in observations]
    pixels = [observation.xy.astype(np.float32) for observation in observations]
    flags = cv2.CALIB_FIX_K3
    _, matrix, _, _, _, sigmas, *_ = cv2.calibrateCameraExtended(
        points, pixels, SIZE, np.eye(3), np.zeros(5), flags=flags
    )
    known = result.fit.adjustment
    assert known.parameters.intrinsics[0][0] == pytest.approx(matrix[0, 0], abs=0.01)
    assert known.sigmas.intrinsics[0] == pytest.approx(sigmas.ravel()[:8], rel=0.05)
