"""KITTI raw's calib_cam_to_cam.txt, as distributed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibration_files import KITTI_RAW, cam1_from_cam0, read, write_file

from vo.base.errors import CalibrationError
from vo.base.geometry.rectification import rectified_rig
from vo.recordings.formats.calibration import read_calibration


def test_kitti_raw_rectified(tmp_path: Path) -> None:
    for size in ((1242, 375), None):
        calibration = read(tmp_path, KITTI_RAW, "calib_cam_to_cam.txt", size)
        assert calibration.kind == "KITTI raw"
        cam0 = calibration.rig.cam0
        assert (cam0.width, cam0.height, cam0.fx, cam0.cy) == (1242, 375, 721.5377, 172.854)
        assert not cam0.is_distorted
        expected = np.eye(4)
        expected[0, 3] = -387.5744 / 721.5377
        np.testing.assert_allclose(cam1_from_cam0(calibration.rig), expected, atol=1e-9)
        # The body is camera 00 as recorded; R_rect_00 takes its points to the rectified one.
        assert calibration.body_from_cam0 is not None
        point = calibration.body_from_cam0[:3, :3].T @ np.array([0.0, 0.0, 1.0])
        np.testing.assert_allclose(point, [-7.445048e-03, -4.278459e-03, 9.999631e-01], atol=1e-6)


def test_kitti_raw_unrectified(tmp_path: Path) -> None:
    calibration = read(tmp_path, KITTI_RAW, "calib_cam_to_cam.txt", (1392, 512))
    rig = calibration.rig
    assert (rig.cam0.width, rig.cam0.fx) == (1392, 984.2439)
    assert rig.cam0.distortion == (-0.3728755, 0.2037299, 2.219027e-03, 1.383707e-03, -0.07233722)
    # R_01, T_01 are cam1_from_cam0; camera 01 is to the right of camera 00.
    np.testing.assert_allclose(
        cam1_from_cam0(rig)[:3, 3], [-0.537, 4.822061e-03, -0.01252488], atol=1e-9
    )
    # Our rectification has the same result as KITTI's.
    assert rectified_rig(rig).baseline_m == pytest.approx(387.5744 / 721.5377, rel=1e-3)
    turn = rectified_rig(rig).cam0_from_rectified[:3, :3].T
    kitti = np.array([[float(x) for x in KITTI_RAW.split("R_rect_00: ")[1].split()[:9]]])
    np.testing.assert_allclose(turn, kitti.reshape(3, 3), atol=0.02)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("R_01: 9.99", "R_01: 5.99", "camera 01: rotation: the rotation is not orthonormal"),
        ("P_rect_00: 7.2", "P_rect_00: -7.2", "must be above 0 (read as KITTI raw calibration)"),
        ("S_rect_00", "S_rect_09", "S_rect_00 is missing"),
        ("-3.875744e+02", "0", "camera 01: the baseline is 0 m"),
        ("K_00: 9.842439e+02", "K_00: nope", "K_00, number 1 is nope"),
    ],
)
def test_error_for_implausible_kitti_raw_files(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in KITTI_RAW
    path = write_file(tmp_path, KITTI_RAW.replace(old, new), "calib_cam_to_cam.txt")
    recorded = "K_00" in old or "R_01: 9" in old
    with pytest.raises(CalibrationError) as caught:
        read_calibration(path, (1392, 512) if recorded else (1242, 375))
    assert expected in str(caught.value)
