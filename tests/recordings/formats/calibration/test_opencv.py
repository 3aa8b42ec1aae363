"""OpenCV's FileStorage, written by OpenCV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibration_files import (
    CAM1_FROM_CAM0,
    D0,
    EXTRINSICS,
    INTRINSICS,
    K0,
    SIZE,
    cam1_from_cam0,
    write_storage,
)

from vo.base.errors import CalibrationError
from vo.recordings.formats.calibration import read_calibration


@pytest.mark.parametrize("suffix", ["yml", "yaml", "xml", "json"])
def test_opencv_pair(tmp_path: Path, suffix: str) -> None:
    values = INTRINSICS | EXTRINSICS | {"image_width": 640, "image_height": 480}
    calibration = read_calibration(write_storage(tmp_path / f"stereo.{suffix}", values))
    assert calibration.kind == "OpenCV"
    rig = calibration.rig
    assert (rig.cam0.width, rig.cam0.height, rig.cam0.fy) == (640, 480, 501.0)
    assert rig.cam0.distortion == pytest.approx(D0, abs=1e-15)
    assert rig.cam1 is not None and rig.cam1.cx == 318.0
    # OpenCV's convention: x2 = R x1 + T.
    np.testing.assert_allclose(cam1_from_cam0(rig), CAM1_FROM_CAM0, atol=1e-12)


@pytest.mark.parametrize("suffix", ["yml", "xml"])
def test_opencv_sample_with_extrinsics_beside(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_storage(tmp_path / f"intrinsics.{suffix}", INTRINSICS)
    assert not read_calibration(path, SIZE).rig.is_stereo
    assert "R and T are missing" in caplog.text
    write_storage(tmp_path / f"extrinsics.{suffix}", EXTRINSICS)
    np.testing.assert_allclose(
        cam1_from_cam0(read_calibration(path, SIZE).rig), CAM1_FROM_CAM0, atol=1e-12
    )
    with pytest.raises(CalibrationError, match="the size of the images is missing"):
        read_calibration(path)


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_opencv_single_camera(tmp_path: Path, suffix: str) -> None:
    values = {
        "calibration_time": "Tue 21 Nov 2026 10:00:00", "nr_of_frames": 25,
        "image_width": 640, "image_height": 480, "fisheye_model": 0,
        "camera_matrix": K0, "distortion_coefficients": np.array([D0]).T,
        "per_view_reprojection_errors": np.ones((25, 1), np.float32),
    }  # fmt: skip
    cam0 = read_calibration(write_storage(tmp_path / f"out.{suffix}", values)).rig.cam0
    assert cam0.distortion_model == "radtan"
    assert cam0.distortion == pytest.approx(D0, abs=1e-15)
    values |= {"fisheye_model": 1, "distortion_coefficients": np.array([D0[:4]]).T}
    cam0 = read_calibration(write_storage(tmp_path / f"fisheye.{suffix}", values)).rig.cam0
    assert cam0.distortion_model == "equidistant"


def test_opencv_with_fourteen_coefficients(tmp_path: Path) -> None:
    rational = [0.4, 0.1, 1e-4, 2e-4, 0.01, 0.7, 0.2, 0.03]
    values = {"image_width": 640, "image_height": 480, "camera_matrix": K0}
    values["distortion_coefficients"] = [rational + [0.0] * 6]
    cam0 = read_calibration(write_storage(tmp_path / "a.yml", values)).rig.cam0
    assert cam0.distortion == pytest.approx(rational)
    values["distortion_coefficients"] = [[*rational, 0.1, 0, 0, 0, 0, 0]]
    with pytest.raises(CalibrationError, match="14 coefficients; those of thin prisms and tilted"):
        read_calibration(write_storage(tmp_path / "b.yml", values))


def test_error_for_an_opencv_rotation_that_is_not_one(tmp_path: Path) -> None:
    values = (
        INTRINSICS | EXTRINSICS | {"image_width": 640, "image_height": 480, "R": np.ones((3, 3))}
    )
    with pytest.raises(CalibrationError, match="rotation is not orthonormal.*OpenCV calibration"):
        read_calibration(write_storage(tmp_path / "stereo.yml", values))
