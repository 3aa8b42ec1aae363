"""Calibration files of other programs, in their documented conventions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vo.errors import CalibrationError
from vo.formats.calibration import Calibration, read_calibration
from vo.geometry.cameras import distort, normalise, project
from vo.geometry.rectification import rectified_rig
from vo.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.types import Floats, Rig

SIZE = (640, 480)
K0 = np.array([[500.0, 0, 320.5], [0, 501.0, 239.0], [0, 0, 1]])
K1 = np.array([[510.0, 0, 318.0], [0, 511.0, 241.0], [0, 0, 1]])
D0 = (-0.28, 0.07, 2e-4, 1.8e-5, 0.01)
D1 = (-0.27, 0.06, -1e-4, -3e-5, 0.02)
CAM1_FROM_CAM0 = make_transform(so3_exp(np.array([0.01, -0.02, 0.015])), [-0.11, 0.002, -0.003])


def _file(folder: Path, text: str, name: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def _read(
    folder: Path, text: str, name: str = "c.yaml", size: tuple[int, int] | None = None
) -> Calibration:
    return read_calibration(_file(folder, text, name), size)


def _error(folder: Path, text: str, name: str = "c.yaml") -> str:
    with pytest.raises(CalibrationError) as caught:
        _read(folder, text, name)
    message = str(caught.value)
    assert "\n" not in message
    return message


def _pair(rig: Rig) -> Floats:
    assert rig.cam1_from_cam0 is not None
    return rig.cam1_from_cam0


def _flat(values: Any) -> str:
    return "[" + ", ".join(f"{float(v):.17g}" for v in np.ravel(values)) + "]"


# KITTI raw: 2011-09-26, as distributed

KITTI_RAW = """calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_00: 1.392000e+03 5.120000e+02
K_00: 9.842439e+02 0.000000e+00 6.900000e+02 0.000000e+00 9.808141e+02 2.331966e+02 0 0 1
D_00: -3.728755e-01 2.037299e-01 2.219027e-03 1.383707e-03 -7.233722e-02
R_00: 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00 0 0 1
T_00: 2.573699e-16 -1.059758e-16 1.614870e-16
S_rect_00: 1.242000e+03 3.750000e+02
R_rect_00: 9.999239e-01 9.837760e-03 -7.445048e-03 -9.869795e-03 9.999421e-01 -4.278459e-03 \
7.402527e-03 4.351614e-03 9.999631e-01
P_rect_00: 7.215377e+02 0.000000e+00 6.095593e+02 0.000000e+00 0.000000e+00 7.215377e+02 \
1.728540e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
S_01: 1.392000e+03 5.120000e+02
K_01: 9.895267e+02 0.000000e+00 7.020000e+02 0.000000e+00 9.878386e+02 2.455590e+02 0 0 1
D_01: -3.644661e-01 1.790019e-01 1.148107e-03 -6.298563e-04 -5.314062e-02
R_01: 9.993513e-01 1.860866e-02 -3.083487e-02 -1.887662e-02 9.997863e-01 -8.421873e-03 \
3.067156e-02 8.998467e-03 9.994890e-01
T_01: -5.370000e-01 4.822061e-03 -1.252488e-02
S_rect_01: 1.242000e+03 3.750000e+02
R_rect_01: 9.996878e-01 -8.976826e-03 2.331651e-02 8.876121e-03 9.999508e-01 4.418952e-03 \
-2.335503e-02 -4.210612e-03 9.997184e-01
P_rect_01: 7.215377e+02 0.000000e+00 6.095593e+02 -3.875744e+02 0.000000e+00 7.215377e+02 \
1.728540e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
"""


def test_kitti_raw_rectified(tmp_path: Path) -> None:
    for size in ((1242, 375), None):
        calibration = _read(tmp_path, KITTI_RAW, "calib_cam_to_cam.txt", size)
        assert calibration.kind == "KITTI raw"
        cam0 = calibration.rig.cam0
        assert (cam0.width, cam0.height, cam0.fx, cam0.cy) == (1242, 375, 721.5377, 172.854)
        assert not cam0.is_distorted
        expected = np.eye(4)
        expected[0, 3] = -387.5744 / 721.5377
        np.testing.assert_allclose(_pair(calibration.rig), expected, atol=1e-9)
        # The body is camera 00 as recorded; R_rect_00 takes its points to the rectified one.
        assert calibration.body_from_cam0 is not None
        point = calibration.body_from_cam0[:3, :3].T @ np.array([0.0, 0.0, 1.0])
        np.testing.assert_allclose(point, [-7.445048e-03, -4.278459e-03, 9.999631e-01], atol=1e-6)


def test_kitti_raw_unrectified(tmp_path: Path) -> None:
    calibration = _read(tmp_path, KITTI_RAW, "calib_cam_to_cam.txt", (1392, 512))
    rig = calibration.rig
    assert (rig.cam0.width, rig.cam0.fx) == (1392, 984.2439)
    assert rig.cam0.distortion == (-0.3728755, 0.2037299, 2.219027e-03, 1.383707e-03, -0.07233722)
    # R_01, T_01 are cam1_from_cam0; camera 01 is to the right of camera 00.
    np.testing.assert_allclose(_pair(rig)[:3, 3], [-0.537, 4.822061e-03, -0.01252488], atol=1e-9)
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
    path = _file(tmp_path, KITTI_RAW.replace(old, new), "calib_cam_to_cam.txt")
    recorded = "K_00" in old or "R_01: 9" in old
    with pytest.raises(CalibrationError) as caught:
        read_calibration(path, (1392, 512) if recorded else (1242, 375))
    assert expected in str(caught.value)


# ROS camera_info, as camera_calibration writes it from OpenCV's stereoRectify


def _rectification() -> tuple[Floats, Floats, Floats, Floats]:
    r0, r1, p0, p1 = cv2.stereoRectify(
        K0, np.array(D0), K1, np.array(D1), SIZE,
        CAM1_FROM_CAM0[:3, :3].copy(), CAM1_FROM_CAM0[:3, 3:4].copy(),
    )[:4]  # fmt: skip
    return r0, r1, p0, p1


def _camera_info(k: Floats, d: Any, r: Floats, p: Floats, model: str = "plumb_bob") -> str:
    return f"""image_width: {SIZE[0]}
image_height: {SIZE[1]}
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: {_flat(k)}
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {len(d)}
  data: {_flat(d)}
rectification_matrix:
  rows: 3
  cols: 3
  data: {_flat(r)}
projection_matrix:
  rows: 3
  cols: 4
  data: {_flat(p)}
"""


def test_ros_pair(tmp_path: Path) -> None:
    r0, r1, p0, p1 = _rectification()
    left = _file(tmp_path, _camera_info(K0, D0, r0, p0), "left.yaml")
    _file(tmp_path, _camera_info(K1, D1, r1, p1), "right.yaml")
    calibration = read_calibration(left)
    assert calibration.kind == "ROS camera_info"
    assert calibration.rig.cam0.distortion == D0
    assert calibration.rig.cam1 is not None and calibration.rig.cam1.distortion == D1
    np.testing.assert_allclose(_pair(calibration.rig), CAM1_FROM_CAM0, atol=1e-9)
    assert not read_calibration(tmp_path / "right.yaml").rig.is_stereo


def test_ros_single_cameras(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    p = np.column_stack([K0, np.zeros(3)])
    rational = (0.4, 0.1, 1e-4, 2e-4, 0.01, 0.7, 0.2, 0.03)
    text = _camera_info(K0, rational, np.eye(3), p, "rational_polynomial")
    left = _file(tmp_path, text, "left_camera.yaml")
    cam0 = read_calibration(left).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("radtan", rational)
    # Two cameras that were calibrated separately are not a pair.
    _file(tmp_path, _camera_info(K1, D1, np.eye(3), p), "right_camera.yaml")
    assert not read_calibration(left).rig.is_stereo
    assert "no baseline" in caplog.text
    fisheye = _camera_info(K0, (0.1, 0.2, 0.3, 0.4), np.eye(3), p, "equidistant")
    cam0 = _read(tmp_path, fisheye).rig.cam0
    assert (cam0.distortion_model, cam0.distortion) == ("equidistant", (0.1, 0.2, 0.3, 0.4))


@pytest.mark.parametrize("names", ["DKRP", "dkrp"])
def test_ros_topic_echo(tmp_path: Path, names: str) -> None:
    r0, _, p0, _ = _rectification()
    d, k, r, p = names
    text = f"""header:
  stamp:
    sec: 12
    nanosec: 5
  frame_id: cam_left
height: {SIZE[1]}
width: {SIZE[0]}
distortion_model: plumb_bob
{d}: {_flat(D0)}
{k}: {_flat(K0)}
{r}: {_flat(r0)}
{p}: {_flat(p0)}
binning_x: 0
---
"""
    calibration = _read(tmp_path, text)
    assert calibration.kind == "ROS camera_info"
    cam0 = calibration.rig.cam0
    assert (cam0.width, cam0.height, cam0.fx, cam0.cx) == (640, 480, 500.0, 320.5)
    assert cam0.distortion == D0


# OpenCV FileStorage, written by OpenCV


def _storage(path: Path, values: dict[str, Any]) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value if isinstance(value, int | float | str) else np.array(value))
    storage.release()
    return path


INTRINSICS = {"M1": K0, "D1": [D0], "M2": K1, "D2": [D1]}
EXTRINSICS = {"R": CAM1_FROM_CAM0[:3, :3], "T": CAM1_FROM_CAM0[:3, 3:4]}


@pytest.mark.parametrize("suffix", ["yml", "yaml", "xml", "json"])
def test_opencv_pair(tmp_path: Path, suffix: str) -> None:
    values = INTRINSICS | EXTRINSICS | {"image_width": 640, "image_height": 480}
    calibration = read_calibration(_storage(tmp_path / f"stereo.{suffix}", values))
    assert calibration.kind == "OpenCV"
    rig = calibration.rig
    assert (rig.cam0.width, rig.cam0.height, rig.cam0.fy) == (640, 480, 501.0)
    assert rig.cam0.distortion == pytest.approx(D0, abs=1e-15)
    assert rig.cam1 is not None and rig.cam1.cx == 318.0
    # OpenCV's convention: x2 = R x1 + T.
    np.testing.assert_allclose(_pair(rig), CAM1_FROM_CAM0, atol=1e-12)


@pytest.mark.parametrize("suffix", ["yml", "xml"])
def test_opencv_sample_with_extrinsics_beside(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = _storage(tmp_path / f"intrinsics.{suffix}", INTRINSICS)
    assert not read_calibration(path, SIZE).rig.is_stereo
    assert "R and T are missing" in caplog.text
    _storage(tmp_path / f"extrinsics.{suffix}", EXTRINSICS)
    np.testing.assert_allclose(_pair(read_calibration(path, SIZE).rig), CAM1_FROM_CAM0, atol=1e-12)
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
    cam0 = read_calibration(_storage(tmp_path / f"out.{suffix}", values)).rig.cam0
    assert cam0.distortion_model == "radtan"
    assert cam0.distortion == pytest.approx(D0, abs=1e-15)
    values |= {"fisheye_model": 1, "distortion_coefficients": np.array([D0[:4]]).T}
    cam0 = read_calibration(_storage(tmp_path / f"fisheye.{suffix}", values)).rig.cam0
    assert cam0.distortion_model == "equidistant"


def test_opencv_with_fourteen_coefficients(tmp_path: Path) -> None:
    rational = [0.4, 0.1, 1e-4, 2e-4, 0.01, 0.7, 0.2, 0.03]
    values = {"image_width": 640, "image_height": 480, "camera_matrix": K0}
    values["distortion_coefficients"] = [rational + [0.0] * 6]
    cam0 = read_calibration(_storage(tmp_path / "a.yml", values)).rig.cam0
    assert cam0.distortion == pytest.approx(rational)
    values["distortion_coefficients"] = [[*rational, 0.1, 0, 0, 0, 0, 0]]
    with pytest.raises(CalibrationError, match="14 coefficients; radtan has 4 or 5 or 8"):
        read_calibration(_storage(tmp_path / "b.yml", values))


def test_error_for_an_opencv_rotation_that_is_not_one(tmp_path: Path) -> None:
    values = (
        INTRINSICS | EXTRINSICS | {"image_width": 640, "image_height": 480, "R": np.ones((3, 3))}
    )
    with pytest.raises(CalibrationError, match="rotation is not orthonormal.*OpenCV calibration"):
        read_calibration(_storage(tmp_path / "stereo.yml", values))


# ORB-SLAM3

ORB_FISHEYE = """%YAML:1.0

#------------------------------------------------------------------------------
File.version: "1.0"
Camera.type: "KannalaBrandt8"

# Left Camera calibration and distortion parameters (OpenCV)
Camera1.fx: 190.97847715128717
Camera1.fy: 190.9733070521226
Camera1.cx: 254.93170605935475
Camera1.cy: 256.8974428996504
Camera1.k1: 0.0034823894022493434
Camera1.k2: 0.0007150348452162257
Camera1.k3: -0.0020532361418706202
Camera1.k4: 0.00020293673591811182

Camera2.fx: 190.44236969414825
Camera2.fy: 190.4344384721956
Camera2.cx: 252.59949716835982
Camera2.cy: 254.91723064636983
Camera2.k1: 0.0034003170790442797
Camera2.k2: 0.001766278153469831
Camera2.k3: -0.00266312569781606
Camera2.k4: 0.0003299517423931039

Stereo.T_c1_c2: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [ 0.999999445773493,   0.000791687752817,   0.000694034010224,   0.101063427414194,
\t    -0.000823363992158,   0.998899461915674,   0.046895490788700,   0.001946204678584,
            -0.000656143613644,  -0.046896036240590,   0.998899560146304,   0.001015350132563,
            0.0,0.0,0.0,1.0]

Camera.width: 512
Camera.height: 512
Camera.fps: 20
Viewer.PointSize:2
IMU.T_b_c1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: f
   data: [0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1]
"""


def test_orb_slam_fisheye_pair(tmp_path: Path) -> None:
    calibration = _read(tmp_path, ORB_FISHEYE, "TUM-VI.yaml")
    assert calibration.kind == "ORB-SLAM3"
    rig = calibration.rig
    assert rig.cam0.distortion_model == "equidistant"
    assert rig.cam1 is not None and rig.cam1.distortion[1] == 0.001766278153469831
    # T_c1_c2 is the pose of camera 2 in camera 1: 10 cm to the right.
    place = inverse(_pair(rig))
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
    rig = _read(tmp_path, ORB_RECTIFIED).rig
    assert rig.cam1 == rig.cam0
    np.testing.assert_allclose(_pair(rig)[:3, 3], [-0.53716, 0, 0])
    old = ORB_RECTIFIED.replace("Camera1.", "Camera.").replace("Rectified", "PinHole")
    old = old.replace("Stereo.b: 0.53716", "Camera.bf: 386.1448").replace("Camera.width: 1241", "")
    rig = _read(tmp_path, old, size=(1241, 376)).rig
    np.testing.assert_allclose(_pair(rig)[:3, 3], [-0.537166, 0, 0], atol=1e-6)


def test_orb_slam_depth_camera_has_no_second_image(tmp_path: Path) -> None:
    text = ORB_RECTIFIED.replace("Rectified", "PinHole") + "RGBD.DepthMapFactor: 5000.0 # 1.0\n"
    text += "Camera1.k1: 0.262383\nCamera1.k2: -0.953104\nCamera1.p1: -0.005358\n"
    calibration = _read(tmp_path, text + "Camera1.p2: 0.002628\nCamera1.k3: 1.163314\n")
    assert not calibration.rig.is_stereo
    assert calibration.depth_per_metre == 5000.0
    expected = (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
    assert calibration.rig.cam0.distortion == expected


def test_orb_slam_unrectified_pair(tmp_path: Path) -> None:
    r0, r1, p0, p1 = _rectification()
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
            text += f"   data:{_flat(value)}\n"
    rig = _read(tmp_path, text, "EuRoC.yaml").rig
    assert rig.cam0.distortion == D0
    np.testing.assert_allclose(_pair(rig), CAM1_FROM_CAM0, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            '"KannalaBrandt8"',
            '"Omni"',
            "Camera.type 'Omni' is not supported; supported are PinHole",
        ),
        ("Stereo.T_c1_c2", "Stereo.other", "Stereo.T_c1_c2 is missing"),
        ("Camera2.k4", "Camera2.k5", "3 coefficients; equidistant has 4"),
        ("Camera1.fy: 190.9", "Camera1.fy: -190.9", "focal length is 190.978, -190.9"),
        ("Camera.width", "Camera.widht", "resolution is missing"),
        ("0.999999445773493", "0.9", "the rotation is not orthonormal"),
    ],
)
def test_error_for_implausible_orb_slam_files(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in ORB_FISHEYE
    message = _error(tmp_path, ORB_FISHEYE.replace(old, new))
    assert expected in message
    assert message.endswith("(read as ORB-SLAM3 calibration)")


# COLMAP

COLMAP = {
    "SIMPLE_PINHOLE": ("600 320 240", (600, 600), "none", ()),
    "PINHOLE": ("600 601 320 240", (600, 601), "none", ()),
    "SIMPLE_RADIAL": ("600 320 240 -0.1", (600, 600), "radtan", (-0.1, 0, 0, 0)),
    "RADIAL": ("600 320 240 -0.1 0.02", (600, 600), "radtan", (-0.1, 0.02, 0, 0)),
    "OPENCV": ("600 601 320 240 1 2 3 4", (600, 601), "radtan", (1, 2, 3, 4)),
    "FULL_OPENCV": (
        "600 601 320 240 1 2 3 4 5 6 7 8", (600, 601), "radtan", (1, 2, 3, 4, 5, 6, 7, 8)
    ),
    "OPENCV_FISHEYE": ("600 601 320 240 1 2 3 4", (600, 601), "equidistant", (1, 2, 3, 4)),
    "SIMPLE_RADIAL_FISHEYE": ("600 320 240 0.1", (600, 600), "equidistant", (0.1, 0, 0, 0)),
    "RADIAL_FISHEYE": ("600 320 240 0.1 0.2", (600, 600), "equidistant", (0.1, 0.2, 0, 0)),
}  # fmt: skip
COLMAP_HEAD = (
    "# Camera list with one line of data per camera:\n"
    "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n# Number of cameras: 1\n"
)


@pytest.mark.parametrize("model", COLMAP)
def test_colmap(tmp_path: Path, model: str) -> None:
    parameters, focal, lens, coefficients = COLMAP[model]
    text = f"{COLMAP_HEAD}1 {model} 640 480 {parameters}\n"
    calibration = _read(tmp_path, text, "cameras.txt")
    assert calibration.kind == "COLMAP"
    cam0 = calibration.rig.cam0
    assert (cam0.width, cam0.height, cam0.fx, cam0.fy) == (640, 480, *focal)
    # The centre of 640 pixels is 320 from the corner of the first pixel, 319.5 from its centre.
    assert (cam0.cx, cam0.cy) == (319.5, 239.5)
    assert (cam0.distortion_model, cam0.distortion) == (lens, coefficients)


def test_colmap_with_several_cameras(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = COLMAP_HEAD + "1 PINHOLE 640 480 600 600 320 240\n2 PINHOLE 800 600 700 700 400 300\n"
    assert _read(tmp_path, text, "cameras.txt", (800, 600)).rig.cam0.fx == 700
    assert "only camera 2 of 2 is used" in caplog.text
    assert _read(tmp_path, text, "cameras.txt").rig.cam0.fx == 600


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (
            "1 FOV 640 480 600 600 320 240 0.9",
            "model FOV is not supported; supported are SIMPLE_PINHOLE",
        ),
        ("1 PINHOLE 640 480 600 320 240", "PINHOLE has 3 numbers; 4 are needed"),
        ("1 PINHOLE 640 480 -600 600 320 240", "focal length is -600, 600"),
        ("1 PINHOLE 0 480 600 600 320 240", "whole numbers above 0"),
    ],
)
def test_error_for_implausible_colmap_files(tmp_path: Path, line: str, expected: str) -> None:
    message = _error(tmp_path, f"{COLMAP_HEAD}{line}\n", "cameras.txt")
    assert expected in message and "camera 1" in message
    assert message.endswith("(read as COLMAP calibration)")


# Basalt


def _basalt(lens: str, values: str) -> str:
    camera = (
        f'{{"camera_type": "{lens}", "intrinsics": {{"fx": 158.28, "fy": 158.27, '
        f'"cx": 254.96, "cy": 256.89{values}}}}}'
    )
    return f"""{{
    "value0": {{
        "T_imu_cam": [
            {{"px": 0.1, "py": 0.2, "pz": 0.3, "qx": 0, "qy": 0, "qz": 0, "qw": 1}},
            {{"px": 0.2, "py": 0.2, "pz": 0.3,
\t      "qx": 0, "qy": 0.0087265355, "qz": 0, "qw": 0.9999619231}}
        ],
        "intrinsics": [{camera}, {camera}],
        "resolution": [[512, 512], [512, 512]],
        "calib_accel_bias": [0.0, 0.0]
    }}
}}"""


BASALT = {
    "pinhole": ("", "none", ()),
    "pinhole-radtan8": (
        ', "k1": 1, "k2": 2, "p1": 3, "p2": 4, "k3": 5, "k4": 6, "k5": 7, "k6": 8, "rpmax": 2.7',
        "radtan", (1, 2, 3, 4, 5, 6, 7, 8),
    ),
    "kb4": (', "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4', "equidistant", (0.1, 0.2, 0.3, 0.4)),
    "ds": (', "xi": -0.172, "alpha": 0.593', "double_sphere", (-0.172, 0.593)),
    "eucm": (', "alpha": 0.59, "beta": 1.127', "extended_unified", (0.59, 1.127)),
    "ucm": (', "alpha": 0.59', "extended_unified", (0.59, 1.0)),
}  # fmt: skip


@pytest.mark.parametrize("lens", BASALT)
def test_basalt(tmp_path: Path, lens: str) -> None:
    values, model, coefficients = BASALT[lens]
    calibration = _read(tmp_path, _basalt(lens, values), "calibration.json")
    assert calibration.kind == "Basalt"
    rig = calibration.rig
    assert (rig.cam0.distortion_model, rig.cam0.distortion) == (model, coefficients)
    assert (rig.cam0.width, rig.cam0.fx, rig.cam0.cy) == (512, 158.28, 256.89)
    assert calibration.body_from_cam0 is not None
    np.testing.assert_allclose(calibration.body_from_cam0[:3, 3], [0.1, 0.2, 0.3])
    # T_imu_cam of cam1: 10 cm along x, rotated by 1 degree about y.
    place = inverse(_pair(rig))
    np.testing.assert_allclose(place[:3, 3], [0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(place[:3, :3], so3_exp(np.deg2rad([0.0, 1.0, 0.0])), atol=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"ds"', '"ftheta"', "camera_type 'ftheta' is not supported; supported are pinhole"),
        ('"alpha": 0.593', '"alpha": 1.5', "alpha is 1.5; for double_sphere it must be"),
        ('"alpha"', '"beta"', "alpha is None; it must be a finite"),
        ('"qw": 1}', '"qw": 0}', "the quaternion has length 0, not 1"),
        ('"px": 0.2', '"px": 0.1', "T_imu_cam: the baseline is 0 m"),
        ("[512, 512], ", "[512], ", "has 1 numbers; 2 are needed"),
        ('"T_imu_cam": [', '"T_imu_cam": 5, "other": [', "T_imu_cam is 5; it must be a list"),
    ],
)  # fmt: skip
def test_error_for_implausible_basalt_files(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    text = _basalt("ds", BASALT["ds"][0])
    assert old in text
    assert expected in _error(tmp_path, text.replace(old, new), "calibration.json")


# Kalibr's other projections


@pytest.mark.parametrize(
    ("model", "intrinsics", "lens", "coefficients", "expected"),
    [
        ("ds", "[-0.2, 0.59, 317.5, 316.1, 724.8, 546.5]", "none", "[]",
         ("double_sphere", (-0.2, 0.59))),
        ("eucm", "[0.6, 1.1, 317.5, 316.1, 724.8, 546.5]", "none", "[]",
         ("extended_unified", (0.6, 1.1))),
        ("omni", "[0.8, 317.5, 316.1, 724.8, 546.5]", "radtan", "[-0.3, 0.1, 5.6e-4, 5.8e-4]",
         ("omni", (0.8, -0.3, 0.1, 5.6e-4, 5.8e-4))),
        ("omni", "[0.8, 317.5, 316.1, 724.8, 546.5]", "none", "[]", ("omni", (0.8,))),
    ],
)  # fmt: skip
def test_kalibr_projections(
    tmp_path: Path, model: str, intrinsics: str, lens: str, coefficients: str, expected: Any
) -> None:
    text = f"""cam0:
  cam_overlaps: [1]
  camera_model: {model}
  distortion_coeffs: {coefficients}
  distortion_model: {lens}
  intrinsics: {intrinsics}
  resolution: [1440, 1080]
  rostopic: /cam0/image_raw
"""
    cam0 = _read(tmp_path, text, "camchain.yaml").rig.cam0
    assert (cam0.fx, cam0.fy, cam0.cx, cam0.cy) == (317.5, 316.1, 724.8, 546.5)
    assert (cam0.distortion_model, cam0.distortion) == expected
    wrong = text.replace(f"distortion_model: {lens}", "distortion_model: equidistant")
    wrong = wrong.replace(f"distortion_coeffs: {coefficients}", "distortion_coeffs: [1, 2, 3, 4]")
    assert f"camera model {model} with distortion model equidistant" in _error(tmp_path, wrong)


# What looks odd is said, but taken


@pytest.mark.parametrize(
    ("intrinsics", "expected"),
    [
        ("[500, 500, -20, 240]", "principal point (-20, 240) is outside the 640x480 image"),
        ("[0.78, 0.79, 0.5, 0.5]", "field of view of 180 degrees; check the unit"),
        ("[20000, 20000, 320, 240]", "field of view of 1.83 degrees"),
        ("[500, 500, 320, 240]", ""),
    ],
)
def test_warning_for_implausible_intrinsics(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, intrinsics: str, expected: str
) -> None:
    _read(tmp_path, f"cam0: {{resolution: [640, 480], intrinsics: {intrinsics}}}")
    assert expected in caplog.text
    assert bool(caplog.records) == bool(expected)


# The same rig in every form gives the same pixels


def test_same_pair_in_three_formats(tmp_path: Path) -> None:
    r0, r1, p0, p1 = _rectification()
    left = _file(tmp_path, _camera_info(K0, D0, r0, p0), "left.yaml")
    _file(tmp_path, _camera_info(K1, D1, r1, p1), "right.yaml")
    opencv = INTRINSICS | EXTRINSICS | {"image_width": 640, "image_height": 480}
    rows = "".join(f"  - {_flat(row)}\n" for row in CAM1_FROM_CAM0)
    kalibr = "".join(
        f"cam{i}:\n  camera_model: pinhole\n  resolution: [640, 480]\n  distortion_model: radtan5\n"
        f"  intrinsics: {_flat([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])}\n"
        f"  distortion_coeffs: {_flat(d)}\n"
        for i, (k, d) in enumerate(((K0, D0), (K1, D1)))
    )
    files = [
        left,
        _storage(tmp_path / "stereo.xml", opencv),
        _file(tmp_path, f"{kalibr}  T_cn_cnm1:\n{rows}", "camchain.yaml"),
    ]
    points = np.random.default_rng(0).uniform((-1, -1, 2), (1, 1, 6), (50, 3))
    expected = [
        cv2.projectPoints(points, np.zeros(3), np.zeros(3), K0, np.array(D0))[0].reshape(-1, 2),
        cv2.projectPoints(
            points, cv2.Rodrigues(CAM1_FROM_CAM0[:3, :3].copy())[0], CAM1_FROM_CAM0[:3, 3], K1,
            np.array(D1),
        )[0].reshape(-1, 2),
    ]  # fmt: skip
    for file in files:
        rig = read_calibration(file).rig
        assert rig.cam1 is not None
        np.testing.assert_allclose(project(rig.cam0, points), expected[0], atol=1e-8)
        in_cam1 = transform_points(_pair(rig), points)
        np.testing.assert_allclose(project(rig.cam1, in_cam1), expected[1], atol=1e-6)
        np.testing.assert_allclose(
            distort(rig.cam0, normalise(rig.cam0, expected[0])), expected[0], atol=1e-9
        )
