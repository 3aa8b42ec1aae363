"""Files of OpenVINS, Kimera, VINS, stella_vslam, SVO, maplab and OKVIS, with exact figures."""

from __future__ import annotations

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
    GYROFLOW,
    MAPLAB,
    OKVIS,
    OPENSFM,
    OPENVINS,
    STELLA,
    VINS_FUSION,
)

from vo.base.types import Camera

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
    mono = text.replace('"stereo"', '"monocular"').replace("k1: 0.0", "k1: -0.18")
    cam0 = read(tmp_path, mono).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("radtan", (-0.18, 0.0, 0.0, 0.0))
    fisheye = mono.replace("perspective", "fisheye").replace("p1:", "k4:").replace("p2:", "x:")
    cam0 = read(tmp_path, fisheye).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("equidistant", (-0.18, 0.0, 0.0, 0.0))
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


# OpenSfM, OpenDroneMap and Gyroflow


def test_opensfm(tmp_path: Path) -> None:
    brown = Camera(320, 200, 160.0, 166.4, 162.7, 93.1, "radtan", (0.03, -0.01, 0.001, 0.002, 0.0))
    cam0 = read(tmp_path, OPENSFM, "cameras.json").rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("radtan", brown.distortion)
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        assert getattr(cam0, name) == pytest.approx(getattr(brown, name)), name
    one_focal = '{"c": {"width": 640, "height": 480, "focal": 0.85, "k1": 0.0, "k2": 0.0}}'
    cam0 = read(tmp_path, one_focal, "camera_models.json").rig.cam0
    assert cam0 == Camera(640, 480, 544.0, 544.0, 319.5, 239.5)
    fisheye = one_focal.replace('"k1"', '"projection_type": "fisheye", "k1"')
    assert read(tmp_path, fisheye).rig.cam0.distortion_model == "equidistant"
    two = f"{one_focal[:-1]}, {OPENSFM[1:]}"
    assert read(tmp_path, two, size=(640, 480)).rig.cam0.fx == 544.0
    assert "has 2 cameras, c, v2 own" in read_error(tmp_path, two)
    assert "projection_type 'dual'" in read_error(tmp_path, fisheye.replace("fisheye", "dual"))


def test_a_section_called_fisheye_says_the_model(tmp_path: Path) -> None:
    expected = Camera(
        480, 320, 200.0, 201.0, 240.0, 160.0, "equidistant", (0.15, -0.22, 0.23, -0.09)
    )
    assert read(tmp_path, GYROFLOW, "profile.json").rig.cam0 == expected
    assert "cannot be undone in 52% of the image" in read_error(
        tmp_path, GYROFLOW.replace("fisheye_params", "params").replace("lens_model", "lens")
    )
