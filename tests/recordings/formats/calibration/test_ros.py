"""ROS's camera_info, as written by camera_calibration from OpenCV's stereoRectify."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibration_files import (
    CAM1_FROM_CAM0,
    D0,
    D1,
    K0,
    K1,
    SIZE,
    cam1_from_cam0,
    camera_info,
    flat_list,
    read,
    rectification,
    write_file,
)

from vo.recordings.formats.calibration import read_calibration


def test_ros_pair(tmp_path: Path) -> None:
    r0, r1, p0, p1 = rectification()
    left = write_file(tmp_path, camera_info(K0, D0, r0, p0), "left.yaml")
    write_file(tmp_path, camera_info(K1, D1, r1, p1), "right.yaml")
    calibration = read_calibration(left)
    assert calibration.kind == "ROS camera_info"
    assert calibration.rig.cam0.distortion == D0
    assert calibration.rig.cam1 is not None and calibration.rig.cam1.distortion == D1
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), CAM1_FROM_CAM0, atol=1e-9)
    assert not read_calibration(tmp_path / "right.yaml").rig.is_stereo


def test_ros_single_cameras(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    p = np.column_stack([K0, np.zeros(3)])
    rational = (0.4, 0.1, 1e-4, 2e-4, 0.01, 0.7, 0.2, 0.03)
    text = camera_info(K0, rational, np.eye(3), p, "rational_polynomial")
    left = write_file(tmp_path, text, "left_camera.yaml")
    cam0 = read_calibration(left).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("radtan", rational)
    # Two cameras that were calibrated separately are not a pair.
    write_file(tmp_path, camera_info(K1, D1, np.eye(3), p), "right_camera.yaml")
    assert not read_calibration(left).rig.is_stereo
    assert "no baseline" in caplog.text
    fisheye = camera_info(K0, (0.1, 0.2, 0.3, 0.4), np.eye(3), p, "equidistant")
    cam0 = read(tmp_path, fisheye).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("equidistant", (0.1, 0.2, 0.3, 0.4))


@pytest.mark.parametrize("names", ["DKRP", "dkrp"])
def test_ros_topic_echo(tmp_path: Path, names: str) -> None:
    r0, _, p0, _ = rectification()
    d, k, r, p = names
    text = f"""header:
  stamp:
    sec: 12
    nanosec: 5
  frame_id: cam_left
height: {SIZE[1]}
width: {SIZE[0]}
distortion_model: plumb_bob
{d}: {flat_list(D0)}
{k}: {flat_list(K0)}
{r}: {flat_list(r0)}
{p}: {flat_list(p0)}
binning_x: 0
---
"""
    calibration = read(tmp_path, text)
    assert calibration.kind == "ROS camera_info"
    cam0 = calibration.rig.cam0
    assert (cam0.width, cam0.height, cam0.fx, cam0.cx) == (640, 480, 500.0, 320.5)
    assert cam0.distortion == D0
