"""Noise, pose and time offset of the inertial sensor, in files laid out as other programs do."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_files import OKVIS, OPENVINS, VINS_FUSION

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.noise_classes import NOISE_CLASSES
from vo.base.types import ImuNoise
from vo.recordings.formats.calibration import (
    Calibration,
    ImuCalibration,
    read_calibration,
    write_calibration,
)
from vo.recordings.sources.imu import FileImu, ImuSamples, usable_noise

NOISE = ImuNoise(gyro_noise=1.7e-4, gyro_walk=1.9e-5, accel_noise=2e-3, accel_walk=3e-3)
CAM0_FROM_IMU = se3_exp(np.array([0.05, -0.02, 0.01, 0.3, -1.2, 0.4]))
IMU_FROM_CAM0 = inverse(CAM0_FROM_IMU)

KALIBR_INPUT = """#Accelerometers
accelerometer_noise_density: 2.0e-03   #Noise density (continuous-time)
accelerometer_random_walk:   3.0e-03   #Bias random walk

#Gyroscopes
gyroscope_noise_density:     1.7e-4   #Noise density (continuous-time)
gyroscope_random_walk:       1.9e-05   #Bias random walk

rostopic:                    /imu0      #the IMU ROS topic
update_rate:                 200.0      #Hz (for discretization of the values above)
"""
KALIBR_OUTPUT = """imu0:
  T_i_b:
  - [1.0, 0.0, 0.0, 0.0]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  accelerometer_noise_density: 0.002
  accelerometer_random_walk: 0.003
  gyroscope_noise_density: 0.00017
  gyroscope_random_walk: 1.9e-05
  model: calibrated
  rostopic: /imu0
  time_offset: 0.0
  update_rate: 200.0
"""
OPENVINS_IMU = "%YAML:1.0\n\n" + KALIBR_OUTPUT.replace("model: calibrated", 'model: "kalibr"')
ORB_SLAM3 = """%YAML:1.0

File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 458.654
Camera1.fy: 457.296
Camera1.cx: 367.215
Camera1.cy: 248.375
Camera1.k1: -0.28340811
Camera1.k2: 0.07395907
Camera1.p1: 0.00019359
Camera1.p2: 1.76187114e-05
Camera.width: 752
Camera.height: 480
Camera.fps: 20
Camera.RGB: 1

# Transformation from camera 0 to body-frame (imu)
IMU.T_b_c1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: f
   data: POSE

# IMU noise
IMU.NoiseGyro: 1.7e-04 # rad/s^0.5
IMU.NoiseAcc: 2.0e-03 # m/s^1.5
IMU.GyroWalk: 1.9e-05 # rad/s^1.5
IMU.AccWalk: 3.0e-03 # m/s^2.5
IMU.Frequency: 200.0
"""
VINS_NOISE = """
#imu parameters       The more accurate parameters you provide, the better performance
acc_n: 0.1          # accelerometer measurement noise standard deviation.
gyr_n: 0.01         # gyroscope measurement noise standard deviation.
acc_w: 0.001        # accelerometer bias random work noise standard deviation.
gyr_w: 0.0001       # gyroscope bias random work noise standard deviation.
g_norm: 9.81007     # gravity magnitude

#unsynchronization parameters
estimate_td: 0
td: 0.0035          # initial value of time offset. unit: s.
"""
CAMODOCAL = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 640
image_height: 400
distortion_parameters: {k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0}
projection_parameters: {fx: 400.0, fy: 400.0, cx: 320.0, cy: 200.0}
"""


@pytest.mark.parametrize(("is_rolling", "readout_s"), [("1", 0.033), ("0", 0.0)])
def test_readout_time_in_settings_of_vins(
    tmp_path: Path, is_rolling: str, readout_s: float
) -> None:
    shutter = f"rolling_shutter: {is_rolling}\nrolling_shutter_tr: 0.033\n"
    mono = write(tmp_path, vins_mono__yaml=CAMODOCAL + shutter)
    assert read_calibration(mono).rig.cam0.readout_s == readout_s
    path = write(tmp_path, euroc__yaml=VINS_FUSION + shutter)
    write(tmp_path, cam0_mei__yaml=CAMODOCAL, cam1_mei__yaml=CAMODOCAL)
    assert read_calibration(path).rig.cam0.readout_s == readout_s


def chain(**cam0: object) -> str:
    """Kalibr's result `camchain-imucam-*.yaml` of one camera."""
    section = {
        "T_cam_imu": CAM0_FROM_IMU.tolist(),
        "cam_overlaps": [],
        "camera_model": "pinhole",
        "distortion_coeffs": [-0.28, 0.07, 0.0002, 0.00002],
        "distortion_model": "radtan",
        "intrinsics": [458.6, 457.2, 367.2, 248.3],
        "resolution": [752, 480],
        "rostopic": "/cam0/image_raw",
        "timeshift_cam_imu": 0.0125,
    }
    return yaml.safe_dump({"cam0": section | cam0})


def write(folder: Path, **files: str) -> Path:
    """Write files, given by names with __ for a dot; returns the first one."""
    paths = [folder / name.replace("__", ".") for name in files]
    for path, text in zip(paths, files.values(), strict=True):
        path.write_text(text)
    return paths[0]


def check_pose(found: Calibration, imu_from_cam0: np.ndarray) -> None:
    assert found.imu.cam0_from_imu is not None
    assert found.imu.cam0_from_imu @ imu_from_cam0 == pytest.approx(np.eye(4), abs=1e-6)


@pytest.mark.parametrize("text", [KALIBR_INPUT, KALIBR_OUTPUT, OPENVINS_IMU])
def test_kalibr(tmp_path: Path, text: str) -> None:
    path = write(tmp_path, camchain_imucam__yaml=chain(), imu__yaml=text)
    found = read_calibration(path)
    assert found.imu.noise == NOISE and found.imu.time_offset_s == 0.0125
    check_pose(found, IMU_FROM_CAM0)


def test_openvins_names_the_file_of_the_imu(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = "relative_config_imu: noise.yaml\nrelative_config_imucam: chain.yaml\n"
    path = write(tmp_path, estimator_config__yaml=settings, chain__yaml=OPENVINS)
    assert read_calibration(path).imu.noise is None
    assert "relative_config_imu 'noise.yaml' does not exist" in caplog.text
    write(tmp_path, noise__yaml=OPENVINS_IMU)
    found = read_calibration(path)
    assert found.imu.noise == NOISE and found.imu.time_offset_s == 0.0
    check_pose(found, np.array([[0, -1, 0, 0.05], [1, 0, 0, 0.04], [0, 0, 1, 0.01], [0, 0, 0, 1]]))


def test_files_beside_that_differ_are_not_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path, camchain__yaml=chain(), imu__yaml=KALIBR_INPUT, imu2__yml=KALIBR_OUTPUT)
    assert read_calibration(path).imu.noise == NOISE  # the same twice
    write(tmp_path, imu2__yml=KALIBR_OUTPUT.replace("0.002", "0.004"))
    assert read_calibration(path).imu.noise is None
    assert "imu.yaml and imu2.yml have different noise of the IMU" in caplog.text


def test_orb_slam3(tmp_path: Path) -> None:
    text = ORB_SLAM3.replace("POSE", str(IMU_FROM_CAM0.ravel().tolist()))
    found = read_calibration(write(tmp_path, EuRoC__yaml=text))
    assert found.imu.noise == NOISE
    check_pose(found, IMU_FROM_CAM0)


def test_vins_fusion_gives_the_noise_of_a_sample(tmp_path: Path) -> None:
    path = write(tmp_path, euroc__yaml=VINS_FUSION + VINS_NOISE)
    write(tmp_path, cam0_mei__yaml=CAMODOCAL, cam1_mei__yaml=CAMODOCAL)
    found = read_calibration(path)
    assert found.imu.noise is not None and found.imu.time_offset_s == 0.0035
    assert found.imu.noise.gyro_noise == pytest.approx(0.01 / 200**0.5)
    assert found.imu.noise.accel_walk == pytest.approx(0.001 / 200**0.5)
    check_pose(found, np.array([[0, -1, 0, 0.05], [1, 0, 0, 0.04], [0, 0, 1, 0.01], [0, 0, 0, 1]]))


def test_okvis(tmp_path: Path) -> None:
    noise = "\nimu_parameters:\n    sigma_g_c: 1.7e-4\n    sigma_a_c: 2.0e-3\n"
    noise += "    sigma_gw_c: 1.9e-5\n    sigma_aw_c: 3.0e-3\n    rate: 200\n"
    noise += "\ncamera_parameters:\n    image_delay: 0.004\n"
    found = read_calibration(write(tmp_path, euroc__yaml=OKVIS + noise))
    assert found.imu.noise == NOISE and found.imu.time_offset_s == -0.004
    assert found.imu.cam0_from_imu is not None


def test_basalt(tmp_path: Path) -> None:
    pose = {"px": 0.1, "py": 0.2, "pz": 0.3, "qx": 0.0, "qy": 0.0, "qz": 1.0, "qw": 0.0}
    lens = {"fx": 400.0, "fy": 400.0, "cx": 320.0, "cy": 200.0}
    value = {
        "T_imu_cam": [pose],
        "intrinsics": [{"camera_type": "pinhole", "intrinsics": lens}],
        "resolution": [[640, 400]],
        "imu_update_rate": 200.0,
        "accel_noise_std": [2e-3] * 3,
        "gyro_noise_std": [1.7e-4] * 3,
        "accel_bias_std": [3e-3] * 3,
        "gyro_bias_std": [1.9e-5] * 3,
        "cam_time_offset_ns": 2_500_000,
    }
    found = read_calibration(write(tmp_path, calibration__json=json.dumps({"value0": value})))
    assert found.imu.noise is not None
    assert found.imu.noise.accel_walk == pytest.approx(3e-3)
    assert found.imu.time_offset_s == pytest.approx(0.0025)
    value["accel_noise_std"] = [2e-3, -2e-3, 2e-3]
    with pytest.raises(CalibrationError, match="accel_noise_std is -0.002; it must be from 0"):
        read_calibration(write(tmp_path, calibration__json=json.dumps({"value0": value})))


OWN = """cam0: {resolution: [640, 400], intrinsics: [400, 400, 320, 200], distortion_model: none}
imu:
  cam0_from_imu: POSE
  time_offset_s: -0.02
  gyro_noise: 1.7e-4
  gyro_walk: 1.9e-5
  accel_noise: 2e-3
  accel_walk: 3e-3
"""


def test_own_format(tmp_path: Path) -> None:
    text = OWN.replace("POSE", str(CAM0_FROM_IMU.tolist()))
    found = read_calibration(write(tmp_path, a__yaml=text))
    assert found.imu.noise == NOISE and found.imu.time_offset_s == -0.02
    check_pose(found, IMU_FROM_CAM0)
    write_calibration(tmp_path / "b.yaml", found.rig, imu=found.imu)
    again = read_calibration(tmp_path / "b.yaml")
    assert again.imu.noise == NOISE and again.imu.time_offset_s == -0.02
    assert found.imu.cam0_from_imu is not None and again.imu.cam0_from_imu is not None
    assert again.imu.cam0_from_imu == pytest.approx(found.imu.cam0_from_imu, abs=1e-15)
    by_class = text.split("  gyro_noise")[0] + "  class: industrial\n"
    found = read_calibration(write(tmp_path, c__yaml=by_class))
    assert found.imu.noise == NOISE_CLASSES["industrial"]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("1.7e-4", ".nan", "imu: gyro_noise is nan; it must be a finite number"),
        ("1.7e-4", "-1.7e-4", "gyro_noise is -0.00017; it must be from 0 to 1 rad/s/√Hz"),
        ("2e-3", "2000", "accel_noise is 2000; it must be from 0 to 100 m/s²/√Hz"),
        ("  gyro_walk: 1.9e-5\n", "", "imu: gyro_walk is missing; noise is given by gyro_noise"),
        ("gyro_walk", "gyro_wlk", "unknown key 'gyro_wlk'; did you mean 'gyro_walk'"),
        ("-0.02", ".inf", "imu.time_offset_s is inf; it must be a finite number"),
        ("  gyro_noise", "  class: consumer\n  gyro_noise", "give either class or gyro_noise"),
        ("imu:\n", "imv:\n", "unknown key 'imv'; did you mean 'imu'"),
        ("POSE", "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0.1,0.2,0.3,1]]", "the matrix is transposed"),
        ("POSE", "[[1,0,0,0],[0,2,0,0],[0,0,1,0],[0,0,0,1]]", "the rotation is not orthonormal"),
        ("POSE", "[[0,1,0,0],[1,0,0,0],[0,0,1,0],[0,0,0,1]]", "determinant -1"),
        ("POSE", "[[1,0,0],[0,1,0],[0,0,1]]", "cam0_from_imu"),
    ],
)
def test_errors(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = OWN.replace(old, new).replace("POSE", str(CAM0_FROM_IMU.tolist()))
    with pytest.raises(CalibrationError) as caught:
        read_calibration(write(tmp_path, a__yaml=text))
    message = str(caught.value)
    assert expected in message and "\n" not in message and "a.yaml" in message


@pytest.mark.parametrize("old", ["0.00017", "0.002"])
def test_errors_of_a_file_beside(tmp_path: Path, old: str) -> None:
    text = KALIBR_OUTPUT.replace(old, "-1")
    path = write(tmp_path, camchain__yaml=chain(), imu__yaml=text)
    with pytest.raises(CalibrationError, match=r"imu.yaml: .*_noise_density is -1; it must be"):
        read_calibration(path)


def test_inverse_convention_in_a_pair(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cam1_from_cam0 = se3_exp(np.array([-0.11, 0.0, 0.0, 0.001, 0.002, 0.0]))
    data = yaml.safe_load(chain())
    data["cam1"] = yaml.safe_load(chain())["cam0"]
    data["cam1"] |= {
        "T_cn_cnm1": cam1_from_cam0.tolist(),
        "T_cam_imu": (cam1_from_cam0 @ CAM0_FROM_IMU).tolist(),
    }
    path = write(tmp_path, camchain__yaml=yaml.safe_dump(data))
    read_calibration(path)
    assert caplog.text == ""
    for name in ("cam0", "cam1"):
        data[name]["T_cam_imu"] = inverse(np.array(data[name]["T_cam_imu"])).tolist()
    read_calibration(write(tmp_path, camchain__yaml=yaml.safe_dump(data)))
    assert "contradict T_cn_cnm1" in caplog.text


def test_a_large_offset_is_suspicious(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path, camchain__yaml=chain(timeshift_cam_imu=12.5))
    assert read_calibration(path).imu.time_offset_s == 12.5
    assert "timeshift_cam_imu is 12.5 s between camera and IMU; it must be in seconds" in (
        caplog.text
    )


def test_unknown_noise_is_that_of_a_consumer_sensor(caplog: pytest.LogCaptureFixture) -> None:
    none = ImuSamples(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))
    imu = FileImu("imu0", lambda: none, lambda: None)
    with caplog.at_level(logging.WARNING, "vo"):
        assert usable_noise(imu) == NOISE_CLASSES["consumer"]
    assert "imu0: noise unknown, that of a consumer sensor is assumed" in caplog.text
    caplog.clear()
    silent = FileImu("imu0", lambda: none, lambda: None, lambda: ImuNoise(0, 0, 0, 0))
    assert min(vars(usable_noise(silent)).values()) > 0 and caplog.text == ""
    assert ImuCalibration().noise is None
