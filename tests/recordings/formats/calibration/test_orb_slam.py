"""Settings of ORB-SLAM3."""

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
    ORB_FISHEYE,
    cam1_from_cam0,
    flat_list,
    read,
    read_error,
    rectification,
)

from vo.base.geometry.rectification import rectified_rig
from vo.base.geometry.transforms import inverse


def test_orb_slam_fisheye_pair(tmp_path: Path) -> None:
    calibration = read(tmp_path, ORB_FISHEYE, "TUM-VI.yaml")
    assert calibration.kind == "ORB-SLAM3"
    rig = calibration.rig
    assert rig.cam0.distortion_model == "equidistant"
    assert rig.cam1 is not None and rig.cam1.distortion[1] == 0.001766278153469831
    # T_c1_c2 is the pose of camera 2 in camera 1: 10 cm to the right.
    place = inverse(cam1_from_cam0(rig))
    np.testing.assert_allclose(place[:3, 3], [0.101063427, 0.001946204, 0.001015350], atol=1e-8)
    assert rectified_rig(rig).baseline_m == pytest.approx(0.1011, abs=1e-4)
    assert calibration.body_from_cam0 is not None
    np.testing.assert_allclose(calibration.body_from_cam0[:3, 3], [0.1, 0.2, 0.3])


ORB_RECTIFIED = """%YAML:1.0
Camera.type: "Rectified"
Camera1.fx: 718.856
Camera1.fy: 718.856
Camera1.cx: 607.1928
Camera1.cy: 185.2157
Camera.width: 1241
Camera.height: 376
Stereo.b: 0.53716
"""


def test_orb_slam_rectified_pair(tmp_path: Path) -> None:
    rig = read(tmp_path, ORB_RECTIFIED).rig
    assert rig.cam1 == rig.cam0
    np.testing.assert_allclose(cam1_from_cam0(rig)[:3, 3], [-0.53716, 0, 0])
    old = ORB_RECTIFIED.replace("Camera1.", "Camera.").replace("Rectified", "PinHole")
    old = old.replace("Stereo.b: 0.53716", "Camera.bf: 386.1448").replace("Camera.width: 1241", "")
    rig = read(tmp_path, old, size=(1241, 376)).rig
    np.testing.assert_allclose(cam1_from_cam0(rig)[:3, 3], [-0.537166, 0, 0], atol=1e-6)


def test_orb_slam_depth_camera_has_no_second_image(tmp_path: Path) -> None:
    text = ORB_RECTIFIED.replace("Rectified", "PinHole") + "RGBD.DepthMapFactor: 5000.0 # 1.0\n"
    text += "Camera1.k1: 0.262383\nCamera1.k2: -0.953104\nCamera1.p1: -0.005358\n"
    calibration = read(tmp_path, text + "Camera1.p2: 0.002628\nCamera1.k3: 1.163314\n")
    assert not calibration.rig.is_stereo
    assert calibration.depth_per_metre == 5000.0
    expected = (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
    assert calibration.rig.cam0.distortion == expected


def test_orb_slam_unrectified_pair(tmp_path: Path) -> None:
    r0, r1, p0, p1 = rectification()
    text = "%YAML:1.0\nCamera.type: PinHole\n" + "".join(
        f"Camera.{name}: {value:.10g}\n"
        for name, value in zip(
            ("fx", "fy", "cx", "cy"), p0[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True
        )
    )
    text += f"Camera.bf: {-p1[0, 3]:.10g}\n"
    for side, k, d, r, p in (("LEFT", K0, D0, r0, p0), ("RIGHT", K1, D1, r1, p1)):
        text += f"{side}.height: 480\n{side}.width: 640\n"
        for name, value in (("D", np.array([d])), ("K", k), ("R", r), ("P", p)):
            rows, cols = value.shape
            text += f"{side}.{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n"
            text += f"   data:{flat_list(value)}\n"
    rig = read(tmp_path, text, "EuRoC.yaml").rig
    assert rig.cam0.distortion == D0
    np.testing.assert_allclose(cam1_from_cam0(rig), CAM1_FROM_CAM0, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            '"KannalaBrandt8"',
            '"Omni"',
            "Camera.type 'Omni' is not supported; supported are PinHole",
        ),
        ("Stereo.T_c1_c2", "Stereo.other", "Stereo.T_c1_c2 is missing"),
        ("Camera2.k4", "Camera2.k5", "Camera2: k4 is missing; equidistant has k1 to k4"),
        ("Camera1.fy: 190.9", "Camera1.fy: -190.9", "focal length is 190.978, -190.9"),
        ("Camera.width", "Camera.widht", "resolution is missing"),
        ("0.999999445773493", "0.9", "the rotation is not orthonormal"),
    ],
)
def test_error_for_implausible_orb_slam_files(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in ORB_FISHEYE
    message = read_error(tmp_path, ORB_FISHEYE.replace(old, new))
    assert expected in message
    assert message.endswith("(read as ORB-SLAM3 calibration)")
