"""Files of OpenVINS, VINS, stella_vslam, SVO, ZED, DepthAI and ROS, with exact figures."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibration_files import cam1_from_cam0, read, read_error, write_file
from foreign_files import (
    CAMODOCAL_KANNALA_BRANDT,
    CAMODOCAL_MEI,
    CAMODOCAL_PINHOLE,
    CAMODOCAL_SCARAMUZZA,
    MAPLAB,
    OKVIS,
    OPENVINS,
    ROS_INI,
    STELLA,
    VINS_FUSION,
    ZED,
    depthai,
)

from vo.errors import CalibrationError
from vo.formats.calibration import read_calibration
from vo.geometry.rectification import rectified_rig
from vo.types import Camera

IMU_FROM_CAM0 = np.array(
    [[0, -1, 0, 0.05], [1, 0, 0, 0.04], [0, 0, 1, 0.01], [0, 0, 0, 1]], dtype=float
)


def shift(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


# OpenVINS and Kalibr with poses on the IMU only


def test_openvins(tmp_path: Path) -> None:
    calibration = read(tmp_path, OPENVINS)
    rig = calibration.rig
    assert calibration.kind == "Kalibr"
    assert rig.cam0 == Camera(
        752, 480, 458.6, 457.2, 367.2, 248.3, "radtan", (-0.28, 0.07, 2e-4, 2e-5)
    )
    assert rig.cam1 is not None
    assert rig.cam1.distortion_model == "equidistant"
    # 0.11 m along the IMU's y, which is the cameras' x; 0.01 m along z.
    np.testing.assert_allclose(cam1_from_cam0(rig), shift(-0.11, 0.0, -0.01), atol=1e-15)
    np.testing.assert_allclose(calibration.body_from_cam0, IMU_FROM_CAM0, atol=1e-15)


def test_kalibr_with_t_cam_imu_of_both_cameras(tmp_path: Path) -> None:
    inverses = {}
    for index, y in enumerate((0.04, 0.15)):
        pose = IMU_FROM_CAM0.copy()
        pose[:3, 3] = 0.05, y, 0.01 * (index + 1)
        inverses[index] = np.linalg.inv(pose)
    text = OPENVINS
    for index, name in enumerate(("cam0", "cam1")):
        head, tail = text.split(f"{name}:\n", 1)
        tail = tail[tail.index("  cam_overlaps") :]
        rows = "".join(f"    - {row.tolist()}\n" for row in inverses[index])
        text = f"{head}{name}:\n  T_cam_imu:\n{rows}{tail}"
    calibration = read(tmp_path, text)
    expected = shift(-0.11, 0.0, -0.01)
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), expected, atol=1e-15)
    np.testing.assert_allclose(calibration.body_from_cam0, IMU_FROM_CAM0, atol=1e-15)


def test_settings_of_openvins_name_the_chain(tmp_path: Path) -> None:
    settings = '%YAML:1.0\nverbosity: "INFO"\nrelative_config_imu: "kalibr_imu_chain.yaml"\n'
    settings += 'relative_config_imucam: "kalibr_imucam_chain.yaml"\n'
    message = read_error(tmp_path, settings, "estimator_config.yaml")
    assert "relative_config_imucam 'kalibr_imucam_chain.yaml' does not exist" in message
    write_file(tmp_path, OPENVINS, "kalibr_imucam_chain.yaml")
    assert read(tmp_path, settings, "estimator_config.yaml").rig.is_stereo


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("  T_imu_cam:\n    - [0.0, -1.0, 0.0, 0.05]", "  T_x:\n    - [0.0, -1.0, 0.0, 0.05]",
         "cam1.T_cn_cnm1 is missing"),
        ("radtan", "fov", "distortion model 'fov' is not supported"),
        ("distortion_coeffs: [-0.28", "bend: [-0.28", "intrinsics has no distortion beside it"),
        ("[1.0, 0.0, 0.0, 0.15]", "[1.1, 0.0, 0.0, 0.15]", "cam1.T_imu_cam: the rotation is not"),
        ("0.15]", ".nan]", "cam1.T_imu_cam, row 2, number 4 is nan"),
    ],
)  # fmt: skip
def test_errors_of_openvins(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in OPENVINS
    assert expected in read_error(tmp_path, OPENVINS.replace(old, new, 1))


def test_kimera(tmp_path: Path) -> None:
    text = """%YAML:1.0
# General sensor definitions.
camera_id: left_cam
T_BS:
  cols: 4
  rows: 4
  data: [0, -1, 0, 0.05, 1, 0, 0, 0.04, 0, 0, 1, 0.01, 0, 0, 0, 1]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.6, 457.2, 367.2, 248.3] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]
"""
    assert not read(tmp_path, text, "LeftCameraParams.yaml").rig.is_stereo
    write_file(tmp_path, text.replace("1, 0, 0, 0.04", "1, 0, 0, 0.15"), "RightCameraParams.yaml")
    calibration = read(tmp_path, text, "LeftCameraParams.yaml")
    assert calibration.kind == "EuRoC"
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), shift(-0.11), atol=1e-15)


# camodocal and VINS


def test_camodocal_cameras(tmp_path: Path) -> None:
    pinhole = read(tmp_path, CAMODOCAL_PINHOLE)
    assert pinhole.kind == "camodocal"
    assert pinhole.rig.cam0 == Camera(
        752, 480, 461.15, 459.75, 362.65, 248.12, "radtan", (-0.29, 0.086, 2.1e-4, 1.1e-5)
    )
    assert read(tmp_path, CAMODOCAL_KANNALA_BRANDT).rig.cam0 == Camera(
        848, 800, 285.96, 286.1, 416.94, 403.75, "equidistant", (-0.0073, 0.043, -0.041, 0.0076)
    )
    assert read(tmp_path, CAMODOCAL_MEI).rig.cam0 == Camera(
        640, 400, 704.4, 703.12, 318.3, 201.5,
        "omni", (1.8476540167437447, -0.061, 0.6, 0.0024, -0.00072),
    )  # fmt: skip


def test_vins_fusion(tmp_path: Path) -> None:
    message = read_error(tmp_path, VINS_FUSION, "vins.yaml")
    assert "cam0_calib: " in message and "cam0_mei.yaml does not exist" in message
    write_file(tmp_path, CAMODOCAL_MEI, "cam0_mei.yaml")
    write_file(tmp_path, CAMODOCAL_MEI.replace("3.1830e+02", "3.1930e+02"), "cam1_mei.yaml")
    calibration = read(tmp_path, VINS_FUSION, "vins.yaml")
    assert calibration.rig.cam1 is not None
    assert (calibration.rig.cam0.cx, calibration.rig.cam1.cx) == (318.3, 319.3)
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), shift(-0.12), atol=1e-15)
    np.testing.assert_allclose(calibration.body_from_cam0, IMU_FROM_CAM0, atol=1e-15)
    mono = VINS_FUSION.replace("num_of_cam: 2", "num_of_cam: 1")
    assert not read(tmp_path, mono, "vins.yaml").rig.is_stereo


def test_vins_mono(tmp_path: Path) -> None:
    text = (
        CAMODOCAL_PINHOLE
        + """estimate_extrinsic: 0
extrinsicRotation: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
extrinsicTranslation: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [0.05, 0.04, 0.01]
"""
    )
    np.testing.assert_allclose(read(tmp_path, text).body_from_cam0, IMU_FROM_CAM0, atol=1e-15)
    unknown = text.replace("estimate_extrinsic: 0", "estimate_extrinsic: 2")
    assert read(tmp_path, unknown).body_from_cam0 is None


@pytest.mark.parametrize(
    ("text", "old", "new", "expected"),
    [
        (CAMODOCAL_SCARAMUZZA, "", "", "model_type SCARAMUZZA is not supported; calibrate with"),
        (CAMODOCAL_PINHOLE, "k1:", "k9:", "distortion_parameters: k1 is missing"),
        (CAMODOCAL_PINHOLE, "4.6115e+02", "-4.6115e+02", "focal length is -461.15"),
        (CAMODOCAL_MEI, "xi:", "x:", "mirror_parameters: xi is missing"),
        (CAMODOCAL_MEI, "1.8476540167437447e+00", ".nan", "mirror_parameters: xi is nan"),
        (CAMODOCAL_PINHOLE, "distortion_parameters:", "other:", "distortion_parameters is None"),
    ],
)
def test_errors_of_camodocal(tmp_path: Path, text: str, old: str, new: str, expected: str) -> None:
    message = read_error(tmp_path, text.replace(old, new))
    assert expected in message
    assert message.endswith("(read as camodocal calibration)")


# stella_vslam and OpenVSLAM


def _dotted(text: str) -> str:
    """The same settings as OpenVSLAM has them: `Camera.fx: 435.2`."""
    lines, section = [], ""
    for line in text.splitlines():
        if line and line[0].isalpha():
            section = line.rstrip(":")
        elif line.strip() and not line.startswith("#"):
            lines.append(f"{section}.{line.strip()}")
    return "\n".join(lines)


@pytest.mark.parametrize("dotted", [False, True])
def test_stella_vslam(tmp_path: Path, dotted: bool) -> None:
    text = _dotted(STELLA) if dotted else STELLA
    calibration = read(tmp_path, text)
    assert calibration.kind == "stella_vslam"
    assert calibration.rig.cam0 == Camera(752, 480, 435.2, 435.2, 367.4, 252.2)
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), shift(-0.11), atol=1e-12)
    mono = text.replace('"stereo"', '"monocular"').replace("k1: 0.0", "k1: -0.28")
    cam0 = read(tmp_path, mono).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("radtan", (-0.28, 0.0, 0.0, 0.0))
    fisheye = mono.replace("perspective", "fisheye").replace("p1:", "k4:").replace("p2:", "x:")
    cam0 = read(tmp_path, fisheye).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("equidistant", (-0.28, 0.0, 0.0, 0.0))
    no_size = text.replace("cols", "c").replace("rows", "r")
    assert read(tmp_path, no_size, size=(640, 480)).rig.cam0.width == 640


def test_stella_vslam_with_a_rectifier(tmp_path: Path) -> None:
    k = np.array([[460.0, 0, 360], [0, 461, 240], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array([0.01, -0.02, 0.005]))[0]
    pose[:3, 3] = -0.11, 0.001, 0.002
    d = np.array([-0.28, 0.07, 2e-4, 2e-5, 0.01])
    r0, r1, p0, p1 = cv2.stereoRectify(
        k, d, k, d, (752, 480), pose[:3, :3].copy(), pose[:3, 3:4].copy()
    )[:4]
    text = STELLA + "StereoRectifier:\n"
    for side, r in (("left", r0), ("right", r1)):
        text += f"  K_{side}: {k.ravel().tolist()}\n  D_{side}: {d.tolist()}\n"
        text += f"  R_{side}: {r.ravel().tolist()}\n"
    text = text.replace("fx: 435.2", f"fx: {p0[0, 0]!r}".replace("np.float64(", "").rstrip(")"))
    text = text.replace("47.872", f"{-p1[0, 3]:.12f}")
    rig = read(tmp_path, text).rig
    assert rig.cam0.distortion == tuple(d)
    assert rig.cam0.fx == 460.0
    np.testing.assert_allclose(cam1_from_cam0(rig), pose, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"perspective"', '"equirectangular"', "model 'equirectangular' is not supported"),
        ('"stereo"', '"quad"', "Camera.setup quad is not supported"),
        ("  k1: 0.0\n", "", "k1 is missing; write 0"),
        ("  k1: 0.0\n", "  k1: 0.1\n", "but StereoRectifier, which says"),
        ("focal_x_baseline: 47.872", "x: 1", "Camera.focal_x_baseline is missing"),
        ("47.872", "-47.872", "Camera.focal_x_baseline is -47.872; it must be above 0"),
    ],
)
def test_errors_of_stella_vslam(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in read_error(tmp_path, STELLA.replace(old, new))


# SVO and maplab


def test_maplab(tmp_path: Path) -> None:
    calibration = read(tmp_path, MAPLAB)
    assert calibration.kind == "SVO or maplab"
    assert calibration.rig.cam0 == Camera(
        640, 480, 384.9, 384.8, 321.4, 239.2, "radtan", (-0.3, 0.1, 0.001, -0.002)
    )
    assert calibration.rig.cam1 == Camera(
        640, 480, 386.1, 386.2, 320.1, 241.0, "equidistant", (-0.005, 0.05, -0.05, 0.01)
    )
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), shift(-0.06), atol=1e-15)
    np.testing.assert_allclose(calibration.body_from_cam0, IMU_FROM_CAM0, atol=1e-15)


def test_a_single_camera_of_aslam(tmp_path: Path) -> None:
    lines = MAPLAB.split("- camera:\n")[1].split("  T_B_C")[0].splitlines()
    calibration = read(tmp_path, "\n".join(line[4:] for line in lines))
    assert calibration.kind == "SVO or maplab"
    assert calibration.rig.cam0.distortion == (-0.3, 0.1, 0.001, -0.002)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "pinhole\n    intrinsics:\n      cols: 1\n      rows: 4\n      data: [384.9,",
            "omni\n    intrinsics:\n      cols: 1\n      rows: 24\n      data: [-206, 0, 384.9,",
            'type "omni (Scaramuzza\'s model)" is not supported',
        ),
        ("type: pinhole", "type: ocam", "camera 0: type 'ocam' is not supported"),
        ("radial-tangential", "fisheye", "distortion type 'fisheye' is not supported"),
        ("1, 0, 0, 0.10", "1, 0, 0, 0.04", "T_B_C: the baseline is 0 m"),
        ("      parameters:\n", "      other:\n", "distortion has 0 coefficients"),
    ],
)
def test_errors_of_maplab(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in MAPLAB
    assert expected in read_error(tmp_path, MAPLAB.replace(old, new, 1))


# OKVIS


def test_okvis(tmp_path: Path) -> None:
    calibration = read(tmp_path, OKVIS)
    assert calibration.kind == "OKVIS"
    assert calibration.rig.cam0 == Camera(
        752, 480, 458.6, 457.2, 367.2, 248.3, "radtan", (-0.28, 0.07, 2e-4, 2e-5)
    )
    assert calibration.rig.cam1 == Camera(
        752, 480, 457.5, 456.1, 379.9, 255.2, "equidistant", (0.01, 0.02, -0.03, 0.004)
    )
    np.testing.assert_allclose(cam1_from_cam0(calibration.rig), shift(-0.11), atol=1e-15)
    np.testing.assert_allclose(calibration.body_from_cam0, IMU_FROM_CAM0, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("radialtangential", "fov", "camera 0: distortion model 'fov' is not supported"),
        ("distortion_coefficients: [-0.28", "bend: [-0.28", "distortion_coefficients is missing"),
        ("focal_length: [458.6,", "focal_length: [-458.6,", "focal length is -458.6, 457.2"),
        ("focal_length: [458.6,", "focal_length: [.nan,", "focal_length, number 1 is nan"),
        ("0.15,", "0.04,", "T_SC: the baseline is 0 m"),
    ],
)
def test_errors_of_okvis(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in OKVIS
    assert expected in read_error(tmp_path, OKVIS.replace(old, new, 1))


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
    assert rectified_rig(rig).is_stereo


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
