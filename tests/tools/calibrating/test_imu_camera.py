"""Pose and time offset of an inertial sensor on a camera, against the truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from board_images import render
from board_motion import CAM0_FROM_IMU, MEMS, SILENT, BoardMotion, corners, move
from typer.testing import CliRunner

import vo
from data_synth.records import BodyTruth, Recording, Shot
from data_synth.writers import euroc
from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import rotation_angle, se3_exp, so3_exp, so3_log
from vo.base.types import Camera, Rig, Trajectory
from vo.cli.app import app
from vo.engine.geometry.so3 import exp_rows, log_rows
from vo.recordings.formats.calibration import ImuCalibration, read_calibration, write_calibration
from vo.tools.calibrating.board import Board, make_board
from vo.tools.calibrating.board_poses import BoardPoses, board_poses
from vo.tools.calibrating.imu_camera import ImuOnCamera, calibrate_imu_camera, warnings_of
from vo.tools.calibrating.kalibr_chain import write_chain

BOARD = make_board("charuco", 7, 5, 0.04)
CAMERA = Camera(640, 480, 460.0, 458.0, 320.0, 240.0, "radtan", (-0.28, 0.07, 2e-4, 2e-5))


def calibrated(
    motion: BoardMotion, noise_px: float = 0.0, board: Board = BOARD
) -> tuple[ImuOnCamera, BoardPoses]:
    poses = board_poses(board, corners(board, CAMERA, motion, noise_px), CAMERA)
    imu = motion.imu
    return calibrate_imu_camera(poses, imu.stamps_ns, imu.gyro, imu.accel, MEMS), poses


@pytest.fixture(scope="module")
def swung() -> tuple[BoardMotion, BoardPoses]:
    motion = move(BOARD, 10.0, noise=MEMS)
    return motion, board_poses(BOARD, corners(BOARD, CAMERA, motion, 0.1), CAMERA)


def errors(found: ImuOnCamera) -> tuple[float, float]:
    """Of the rotation in degrees, and of the position in metres."""
    off = found.cam0_from_imu @ np.linalg.inv(CAM0_FROM_IMU)
    place = found.cam0_from_imu[:3, 3] - CAM0_FROM_IMU[:3, 3]
    return float(np.degrees(rotation_angle(off[:3, :3]))), float(np.linalg.norm(place))


def test_nearly_exact_without_noise() -> None:
    found, poses = calibrated(move(BOARD, 8.0, noise=SILENT, offset_s=0.013))
    rotation_deg, position_m = errors(found)
    assert rotation_deg < 0.01 and position_m < 5e-4
    assert found.time_offset_s == pytest.approx(0.013, abs=1e-4)
    assert poses.rms_px < 1e-9 and found.views == 160


@pytest.mark.parametrize("offset_s", [-0.05, 0.03])
def test_with_noise(offset_s: float) -> None:
    found, _ = calibrated(move(BOARD, 12.0, noise=MEMS, offset_s=offset_s), 0.15)
    rotation_deg, position_m = errors(found)
    assert rotation_deg < 0.05 and position_m < 3e-3
    assert found.time_offset_s == pytest.approx(offset_s, abs=2e-4)
    assert rotation_deg < 5 * np.linalg.norm(found.rotation_sd_deg)
    assert position_m < 4 * np.linalg.norm(found.translation_sd_m)
    assert 0.7 < found.misfit < 1.3 and warnings_of(found) == []


def test_views_that_are_wrong_hardly_matter(swung: tuple[BoardMotion, BoardPoses]) -> None:
    motion, poses = swung
    spoiled = poses.board_from_cam.copy()
    spoiled[::25, :3, 3] += 0.03
    imu = motion.imu
    found = calibrate_imu_camera(
        replace(poses, board_from_cam=spoiled), imu.stamps_ns, imu.gyro, imu.accel, MEMS
    )
    rotation_deg, position_m = errors(found)
    assert rotation_deg < 0.1 and position_m < 5e-3


def test_gaps_are_not_bridged(swung: tuple[BoardMotion, BoardPoses]) -> None:
    motion, poses = swung
    kept = np.ones(len(poses.stamps_ns), dtype=bool)
    kept[60:90] = kept[140:142] = kept[160] = False
    some = replace(
        poses,
        stamps_ns=poses.stamps_ns[kept],
        board_from_cam=poses.board_from_cam[kept],
        information=poses.information[kept],
    )
    imu = motion.imu
    found = calibrate_imu_camera(some, imu.stamps_ns, imu.gyro, imu.accel, MEMS)
    rotation_deg, position_m = errors(found)
    assert rotation_deg < 0.1 and position_m < 5e-3 and found.views == kept.sum()


def test_what_cannot_be_calibrated_is_refused(swung: tuple[BoardMotion, BoardPoses]) -> None:
    with pytest.raises(CalibrationError, match="consecutive images; at least 40 are needed"):
        calibrated(move(BOARD, 1.5))
    with pytest.raises(CalibrationError, match="turned about one axis only"):
        calibrated(move(BOARD, 4.0, axes=(0.0, 0.0, 1.0)))
    motion, poses = swung
    imu = motion.imu
    with pytest.raises(CalibrationError, match="left-handed"):
        calibrate_imu_camera(poses, imu.stamps_ns, imu.gyro * [1, 1, -1], imu.accel, MEMS)
    with pytest.raises(CalibrationError, match="does not match the gyroscope"):
        calibrate_imu_camera(poses, imu.stamps_ns, imu.gyro[::-1], imu.accel, MEMS)
    with pytest.raises(CalibrationError, match="does not match the gyroscope"):
        calibrate_imu_camera(poses, imu.stamps_ns + 10**13, imu.gyro, imu.accel, MEMS)


def test_exponentials_of_many_rotations() -> None:
    rotvec = np.random.default_rng(1).normal(0.0, 0.7, (20, 3))
    rotvec[0] = 0.0
    rotvec[1] *= 1e-10
    rotation = exp_rows(rotvec)
    for one, expected in zip(rotvec, rotation, strict=True):
        assert so3_exp(one) == pytest.approx(expected, abs=1e-12)
        assert so3_log(expected) == pytest.approx(one, abs=1e-9)
    assert log_rows(rotation) == pytest.approx(rotvec, abs=1e-9)


SMALL = Camera(320, 240, 230.0, 229.0, 160.0, 120.0, "radtan", (-0.1, 0.02, 0.0, 0.0))
SMALL_BOARD = make_board("charuco", 5, 4, 0.04)
OPTIONS = ["--board", "charuco", "--columns", "5", "--rows", "4", "--square", "0.04"]


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six seconds of rendered images of a board, as EuRoC."""
    motion = move(SMALL_BOARD, 6.0, noise=MEMS, offset_s=0.02, distance_m=0.4)
    world_from_cam = np.linalg.inv(motion.cam_from_board)
    none = np.zeros((len(motion.stamps_ns), 3))
    recording = Recording(
        name="swing",
        rig=Rig(SMALL),
        body_from_cam0=np.eye(4),
        fps=20.0,
        stamps_ns=(motion.stamps_ns,),
        dropped=(np.zeros(len(motion.stamps_ns), dtype=bool),),
        cam0_truth=Trajectory(motion.stamps_ns, world_from_cam),
        body_truth=BodyTruth(motion.stamps_ns, world_from_cam, none, none, none),
        imu=motion.imu,
        movers=(),
        has_depth=False,
    )

    def shots() -> Iterator[Shot]:
        for number, pose in enumerate(motion.cam_from_board):
            yield Shot(number, (render(SMALL_BOARD, SMALL, pose),))

    path = tmp_path_factory.mktemp("imu") / "swing"
    euroc.write(path, recording, shots(), "png")
    return path


def run(swing: Path, output: Path, *more: str) -> dict[str, object]:
    words = ["calibrate", "--imu", str(swing), *OPTIONS, "-o", str(output), "--json", *more]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.stderr
    found: dict[str, object] = json.loads(result.stdout)
    return found


def check(path: Path, rotation_deg: float, position_m: float) -> None:
    imu = read_calibration(path, (320, 240)).imu
    assert imu.cam0_from_imu is not None
    off = imu.cam0_from_imu @ np.linalg.inv(CAM0_FROM_IMU)
    assert np.degrees(rotation_angle(off[:3, :3])) < rotation_deg
    assert np.linalg.norm(imu.cam0_from_imu[:3, 3] - CAM0_FROM_IMU[:3, 3]) < position_m
    assert imu.time_offset_s == pytest.approx(0.02, abs=5e-4)


def test_the_command_with_calibrated_cameras(swing: Path, tmp_path: Path) -> None:
    write_calibration(tmp_path / "cameras.yaml", Rig(SMALL))
    output = tmp_path / "a.yaml"
    found = run(swing, output, "--calibration", str(tmp_path / "cameras.yaml"))
    assert found["views"] == 120
    for path in (output, tmp_path / "camchain-imucam.yaml"):
        check(path, 0.3, 0.01)
    assert read_calibration(output).imu.noise == MEMS
    again = CliRunner().invoke(app, ["calibrate", "--imu", str(swing), "-o", str(output)])
    assert again.exit_code == 1 and "exists already" in again.stderr
    words = {"board": "charuco", "columns": 5, "rows": 4, "square": 0.04}
    (tmp_path / "py").mkdir()
    result = vo.calibrate_imu(
        swing,
        tmp_path / "py" / "a.yaml",
        calibration=tmp_path / "cameras.yaml",
        **words,  # type: ignore[arg-type]
    )
    assert result.kalibr == tmp_path / "py" / "camchain-imucam.yaml" and result.found.views == 120
    for name in ("a.yaml", "camchain-imucam.yaml"):
        assert (tmp_path / "py" / name).read_bytes() == (tmp_path / name).read_bytes()


def test_the_command_calibrates_cameras_too(swing: Path, tmp_path: Path) -> None:
    run(swing, tmp_path / "a.yaml")
    check(tmp_path / "a.yaml", 1.0, 0.03)


def test_kalibrs_layout_of_a_pair(tmp_path: Path) -> None:
    cam1_from_cam0 = se3_exp(np.array([-0.11, 0.0, 0.01, 0.01, -0.02, 0.0]))
    imu = ImuCalibration(CAM0_FROM_IMU, MEMS, -0.004)
    path = tmp_path / "camchain-imucam.yaml"
    assert write_chain(path, Rig(CAMERA, SMALL, cam1_from_cam0), imu) == ""
    found = read_calibration(path)
    assert found.rig.cam0 == CAMERA and found.rig.cam1 == SMALL and found.kind == "Kalibr"
    assert found.rig.cam1_from_cam0 == pytest.approx(cam1_from_cam0, abs=1e-12)
    assert found.imu.cam0_from_imu == pytest.approx(CAM0_FROM_IMU, abs=1e-12)
    assert found.imu.time_offset_s == -0.004
    lens = replace(CAMERA, distortion=(-0.28, 0.07, 2e-4, 2e-5, 0.1))
    assert "Kalibr has no radtan" in write_chain(tmp_path / "b.yaml", Rig(lens), imu)
    assert not (tmp_path / "b.yaml").exists()


def test_options_that_do_not_fit(swing: Path, tmp_path: Path) -> None:
    words = ["calibrate", str(swing), "--calibration", "x.yaml", "-o", str(tmp_path / "a.yaml")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1 and "--calibration gives the cameras for --imu" in result.stderr
