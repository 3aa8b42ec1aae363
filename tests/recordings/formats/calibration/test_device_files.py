"""Files of ZED, DepthAI and ROS, with exact figures."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibration_files import cam1_from_cam0, read, read_error, write_file
from foreign_files import ROS_INI, ZED, depthai

from vo.base.errors import CalibrationError
from vo.base.geometry.rectification import rectified_rig
from vo.base.types import Camera
from vo.recordings.formats.calibration import read_calibration

IMU_FROM_CAM0 = np.array(
    [[0, -1, 0, 0.05], [1, 0, 0, 0.04], [0, 0, 1, 0.01], [0, 0, 0, 1]], dtype=float
)


def shift(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


# ZED


@pytest.mark.parametrize(("size", "fx"), [((1280, 720), 700.205), ((2208, 1242), 1400.41)])
def test_zed(tmp_path: Path, size: tuple[int, int], fx: float) -> None:
    rig = read(tmp_path, ZED, "SN12345.conf", size).rig
    assert (rig.cam0.width, rig.cam0.fx) == (size[0], fx)
    assert rig.cam0.distortion == (-0.171, 0.026, 0.0001, -0.0002, 0.001)
    assert rig.cam1 is not None and rig.cam1.distortion[0] == -0.172
    suffix = 1e-5 * (size[0] == 1280)
    vector = np.array([0.00239 + suffix, 0.00697 + suffix, -0.00213 - suffix])
    expected = np.eye(4)
    expected[:3, :3] = cv2.Rodrigues(vector)[0]
    expected[:3, 3] = -0.119905, 0.0000458908, -0.000467919
    np.testing.assert_allclose(cam1_from_cam0(rig), expected, atol=1e-12)
    assert rectified_rig(rig).is_metric


def test_zed_with_translations_by_resolution(tmp_path: Path) -> None:
    text = ZED.replace("TY=0.0458908", "TY_HD=0.1").replace("TZ=-0.467919", "TZ_2K=9")
    pose = cam1_from_cam0(read(tmp_path, text, "SN1.conf", (1280, 720)).rig)
    np.testing.assert_allclose(pose[:3, 3], [-0.119905, 0.0001, 0.0], atol=1e-15)


def test_zed_with_a_distortion_for_all_resolutions(tmp_path: Path) -> None:
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    values = (1.5, -0.7, 1e-4, -2e-4, 0.3, 1.8, -0.6, 0.2)
    lines = "".join(f"{name} = {value}\n" for name, value in zip(names, values, strict=True))
    rig = read(tmp_path, f"{ZED}\n[LEFT_DISTO]\n{lines}", "SN1.conf", (1280, 720)).rig
    assert rig.cam0.distortion == values
    assert rig.cam1 is not None and len(rig.cam1.distortion) == 5
    fisheye = "k1 = 0.03\nk2 = -0.01\nk3 = 0.002\nk4 = -0.001\nk5 = 0\nk6 = 0\np1 = 0\np2 = 0\n"
    text = f"{ZED}\n[LEFT_DISTO]\n{fisheye}\n[RIGHT_DISTO]\n{fisheye}"
    rig = read(tmp_path, text, "SN1.conf", (1280, 720)).rig
    assert rig.cam0.distortion_model == "equidistant"
    assert rig.cam0.distortion == (0.03, -0.01, 0.002, -0.001)
    without = "\n".join(line for line in ZED.splitlines() if line[:1] not in "kp")
    assert read(tmp_path, f"{without}\n[LEFT_DISTO]\n{lines}\n[RIGHT_DISTO]\n{lines}", "SN1.conf",
                (1280, 720)).rig.cam0.distortion == values  # fmt: skip


def test_errors_of_zed(tmp_path: Path) -> None:
    path = write_file(tmp_path, ZED, "SN12345.conf")
    with pytest.raises(CalibrationError) as caught:
        read_calibration(path, (2560, 720))
    assert "no section for images of 2560x720; it has 2208x1242 (2K), 1280x720 (HD); each" in str(
        caught.value
    )
    assert "the size of the images is needed" in read_error(tmp_path, ZED)
    for old, new, expected in (
        ("RX_HD=0.0024", "", "[STEREO] RX_HD is missing"),
        ("Baseline=119.905", "Baseline=nan", "[STEREO] Baseline_HD is nan"),
        ("fx=700.205", "fx=-700.205", "focal length is -700.205"),
        ("fx=700.205", "fx 700.205", "is not INI"),
        ("k1", "x1", "[LEFT_CAM_HD]: k1 is missing, and there is no [LEFT_DISTO]"),
    ):
        path.write_text(ZED.replace(old, new))
        with pytest.raises(CalibrationError, match="read as ZED") as caught:
            read_calibration(path, (1280, 720))
        assert expected in str(caught.value)
        assert "\n" not in str(caught.value)


# DepthAI


def test_depthai(tmp_path: Path) -> None:
    calibration = read(tmp_path, depthai(), "calib.json", (1280, 800))
    rig = calibration.rig
    assert calibration.kind == "DepthAI"
    assert rig.cam0 == Camera(
        1280, 800, 799.7, 799.7, 640.0, 400.0,
        "radtan", (9.5, -102.0, 1e-3, -2e-3, 400.0, 9.3, -101.0, 399.0),
    )  # fmt: skip
    expected = shift(-0.0758, -0.0001, 0.0004)
    expected[1:3, 1:3] = [[0.8, -0.6], [0.6, 0.8]]
    np.testing.assert_allclose(cam1_from_cam0(rig), expected, atol=1e-15)
    colour = read(tmp_path, depthai(), "calib.json", (1920, 1200)).rig
    assert (colour.is_stereo, colour.cam0.fx) == (False, 1450.0)


def test_depthai_along_a_chain(tmp_path: Path) -> None:
    """The pair 0 and 1, which only camera 2 connects."""
    stereo = {"leftCameraSocket": 1, "rightCameraSocket": 0}
    data = json.loads(depthai(stereoRectificationData=stereo))
    for entry in data["cameraData"]:
        entry[1] |= {"width": 1280, "height": 800, "intrinsicMatrix": [[8e2, 0, 640], [0, 8e2, 400],
                                                                       [0, 0, 1]]}  # fmt: skip
    pose = cam1_from_cam0(read(tmp_path, json.dumps(data), "c.json", (1280, 800)).rig)
    link = shift(0.0, -0.0001, 0.0004)
    link[1:3, 1:3] = [[0.8, -0.6], [0.6, 0.8]]
    first, second = link.copy(), link.copy()
    first[0, 3], second[0, 3] = -0.0758, 0.0375
    np.testing.assert_allclose(pose, second @ first, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"cameraType": 0', '"cameraType": 3', "cameraType 3 is not supported"),
        ('"toCameraSocket": 2', '"toCameraSocket": 7', "no extrinsics connect cameras 1 and 2"),
        ('"distortionCoeff"', '"d"', "distortionCoeff is missing"),
        ("0.8", "0.9", "the rotation is not orthonormal"),
        ("799.7", "NaN", "number 1 is nan"),
    ],
)
def test_errors_of_depthai(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in read_error(tmp_path, depthai().replace(old, new), "c.json")


# ROS as INI


def test_ros_ini(tmp_path: Path) -> None:
    write_file(tmp_path, ROS_INI, "left.ini")
    right = ROS_INI.replace("/left", "/right").replace("321.000000 0.0", "321.000000 -57.6")
    write_file(tmp_path, right.replace("320.500000", "318.500000"), "right.ini")
    calibration = read_calibration(tmp_path / "left.ini")
    assert calibration.kind == "ROS camera_info"
    assert calibration.rig.cam0 == Camera(
        640, 480, 500.1, 500.9, 320.5, 239.0, "radtan", (-0.28, 0.07, 2e-4, 2e-5, 0.0)
    )
    assert calibration.rig.cam1 is not None and calibration.rig.cam1.cx == 318.5
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), shift(-0.12), atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (" 0.000020 0.000000", " 0.000020", "4 coefficients may be those of plumb_bob or of a"),
        ("distortion\n-0.280000 0.070000 0.000200 0.000020 0.000000\n", "", "has no distortion"),
        ("500.100000", "nan", "number 1 is nan"),
        ("500.100000 0.000000 320.500000", "500.100000 0.000000", "has 8 numbers; 9 are needed"),
        ("width\n640", "width\n0", "resolution is ['0', '480']"),
    ],
)
def test_errors_of_ros_ini(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in ROS_INI
    assert expected in read_error(tmp_path, ROS_INI.replace(old, new), "ost.txt")
