"""Spellings of keys: a distortion that the file contains is never lost."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from calibration_files import CAM1_FROM_CAM0, D0, D1, K0, K1, cam1_from_cam0, read, read_error

from vo.recordings.formats.calibration import read_calibration

SIZE = (640, 480)
MATRICES = ["camera_matrix", "cameraMatrix", "mtx", "K", "Camera_Matrix", "intrinsic_matrix", "M"]
DISTORTIONS = [
    "dist_coeff", "dist_coeffs", "dist", "D", "distCoeff", "distCoeffs", "distortion",
    "distortion_coeffs", "distortion_coefficients", "dist_coef", "dist_coefs",
    "Distortion_Coefficients", "DistCoeffs", "distortion-coefficients", "DISTORTION", "d",
    "distortionCoefficients", "distortion_vector",
]  # fmt: skip


def _text(matrix: str, distortion: str, suffix: str) -> str:
    data = {matrix: K0.tolist(), distortion: [list(D0)]}
    return json.dumps(data) if suffix == "json" else yaml.safe_dump(data)


@pytest.mark.parametrize("matrix", MATRICES)
@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_every_spelling_of_the_distortion(tmp_path: Path, matrix: str, distortion: str) -> None:
    for suffix in ("yaml", "json"):
        text = _text(matrix, distortion, suffix)
        calibration = read(tmp_path, text, f"c.{suffix}", SIZE)
        assert calibration.kind == "OpenCV"
        cam0 = calibration.rig.cam0
        assert (cam0.distortion_model, cam0.distortion) == ("radtan", D0)
        assert (cam0.fx, cam0.fy, cam0.cx, cam0.cy) == (500.0, 501.0, 320.5, 239.0)


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_spellings_in_files_of_opencv(tmp_path: Path, suffix: str) -> None:
    for number, (matrix, distortion) in enumerate([("mtx", "dist"), ("K", "distCoeffs")]):
        path = tmp_path / f"{number}.{suffix}"
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write(matrix, K0)
        storage.write(distortion, np.array([D0]))
        storage.release()
        assert read_calibration(path, SIZE).rig.cam0.distortion == pytest.approx(D0, abs=1e-15)


@pytest.mark.parametrize(
    "names",
    [
        ("M1", "D1", "M2", "D2"),
        ("K0", "D0", "K1", "D1"),
        ("camera_matrix_left", "dist_coeff_left", "camera_matrix_right", "dist_coeff_right"),
        ("mtx_l", "dist_l", "mtx_r", "dist_r"),
        ("left_K", "left_D", "right_K", "right_D"),
        ("cameraMatrix1", "distCoeff1", "cameraMatrix2", "distCoeff2"),
        ("Left_Camera_Matrix", "Left_Distortion", "Right_Camera_Matrix", "Right_Distortion"),
    ],
)
def test_spellings_of_a_pair(tmp_path: Path, names: tuple[str, ...]) -> None:
    values = [K0.tolist(), list(D0), K1.tolist(), list(D1)]
    data = dict(zip(names, values, strict=True))
    data |= {"R": CAM1_FROM_CAM0[:3, :3].tolist(), "T": CAM1_FROM_CAM0[:3, 3].tolist()}
    rig = read(tmp_path, yaml.safe_dump(data), size=SIZE).rig
    assert rig.cam1 is not None
    assert (rig.cam0.distortion, rig.cam1.distortion) == (D0, D1)
    assert (rig.cam0.cx, rig.cam1.cx) == (320.5, 318.0)
    np.testing.assert_allclose(cam1_from_cam0(rig), CAM1_FROM_CAM0, atol=1e-12)


def test_sections_of_a_pair(tmp_path: Path) -> None:
    sides = [{"camera_matrix": k.tolist(), "dist_coeffs": list(d)} for k, d in ((K0, D0), (K1, D1))]
    data = {"left": sides[0], "right": sides[1], "image_size": [640, 480]}
    data |= {"R": CAM1_FROM_CAM0[:3, :3].tolist(), "T": CAM1_FROM_CAM0[:3, 3].tolist()}
    rig = read(tmp_path, json.dumps(data), "c.json").rig
    assert rig.cam1 is not None
    assert (rig.cam0.distortion, rig.cam1.distortion) == (D0, D1)


def test_coefficients_one_by_one(tmp_path: Path) -> None:
    data = {"K": K0.tolist(), "k1": -0.28, "k2": 0.07, "p1": 2e-4, "p2": 1.8e-5, "k3": 0.01}
    assert read(tmp_path, yaml.safe_dump(data), size=SIZE).rig.cam0.distortion == D0
    data = {"K": K0.tolist(), "distortion": {"k1": -0.28, "k2": 0.07, "p1": 2e-4, "p2": 1.8e-5}}
    assert read(tmp_path, yaml.safe_dump(data), size=SIZE).rig.cam0.distortion == D0[:4]


def test_a_camera_matrix_without_distortion_is_refused(tmp_path: Path) -> None:
    data = {"camera_matrix": K0.tolist(), "rms": 0.3, "lens_bend": list(D0)}
    message = read_error(tmp_path, yaml.safe_dump(data, sort_keys=False))
    assert "the size of the images is missing" in message
    data |= {"image_width": 640, "image_height": 480}
    message = read_error(tmp_path, yaml.safe_dump(data, sort_keys=False))
    assert "camera_matrix has no distortion beside it" in message
    assert "the keys are camera_matrix, rms, lens_bend, image_width, image_height;" in message
    assert "add distortion_coefficients: [k1, k2, p1, p2, k3], or []" in message
    pair = {"M1": K0.tolist(), "D1": list(D0), "M2": K1.tolist(), "image_size": [640, 480]}
    pair |= {"R": np.eye(3).tolist(), "T": [-0.1, 0, 0]}
    assert "M2 has no distortion beside it" in read_error(tmp_path, yaml.safe_dump(pair))


@pytest.mark.parametrize(
    "statement",
    [
        {"dist_coeffs": []},
        {"dist_coeffs": [0, 0, 0, 0, 0]},
        {"rectified": True},
        {"P": [[500, 0, 320.5, 0], [0, 501, 239, 0], [0, 0, 1, 0]]},
    ],
)
def test_an_ideal_camera_that_the_file_states(tmp_path: Path, statement: dict[str, object]) -> None:
    data = {"camera_matrix": K0.tolist(), **statement}
    assert read(tmp_path, yaml.safe_dump(data), size=SIZE).rig.cam0.distortion_model == "none"


def test_two_different_distortions(tmp_path: Path) -> None:
    data = {"K": K0.tolist(), "D": list(D0), "dist": list(D0), "image_size": [640, 480]}
    assert read(tmp_path, yaml.safe_dump(data)).rig.cam0.distortion == D0
    data["dist"] = list(D1)
    assert "dist and D differ" in read_error(tmp_path, yaml.safe_dump(data))


@pytest.mark.parametrize(
    ("model", "coefficients", "expected"),
    [
        ({"distortion_model": "fisheye"}, [0.1, 0.2, 0.3, 0.4], "equidistant"),
        ({"distortion_model": "plumb_bob"}, list(D0), "radtan"),
        ({"camera_model": "kannala_brandt"}, [0.1, 0.2, 0.3, 0.4], "equidistant"),
        ({"model": "GoPro Hero 4"}, list(D0), "radtan"),
        ({"is_fisheye": True}, [0.1, 0.2, 0.3, 0.4], "equidistant"),
        ({"xi": 0.9}, [0.1, 0.2, 0.3, 0.4], "omni"),
    ],
)
def test_the_lens_model_that_the_file_names(
    tmp_path: Path, model: dict[str, object], coefficients: list[float], expected: str
) -> None:
    data = {"K": K0.tolist(), "D": coefficients, **model}
    cam0 = read(tmp_path, yaml.safe_dump(data), size=SIZE).rig.cam0
    assert cam0.distortion_model == expected
    assert cam0.distortion == ((0.9, *coefficients) if expected == "omni" else (*coefficients,))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"distortion_model": "ftheta"}, "distortion_model 'ftheta' is not supported"),
        ({"camera_model": "fov"}, "camera_model 'fov' is not supported"),
        ({"camera_model": "omni"}, "xi is missing"),
        ({"D": {"k1": 0.1, "k2": 0.1, "k3": 0.1, "k4": 0.1}}, "those of a fisheye lens"),
        ({"D": [0.1, 0.2, 0.3]}, "distortion has 3 coefficients; radtan has 4 or 5 or 8"),
        ({"D": [0.1, float("nan"), 0.3, 0.1]}, "number 2 is nan"),
        ({"K": K0.T.tolist()}, "the camera matrix is transposed"),
        ({"K": np.zeros((3, 3)).tolist()}, "the camera matrix is zero"),
        ({"K": (2 * K0).tolist()}, "they must be [0, fy, cy] and [0, 0, 1]"),
        ({"K": (K0 * (-1, 1, 1)).tolist()}, "focal length is -500, 501"),
    ],
)
def test_errors_of_values(tmp_path: Path, changes: dict[str, object], expected: str) -> None:
    data = {"K": K0.tolist(), "D": list(D0), "image_size": [640, 480]} | changes
    assert expected in read_error(tmp_path, yaml.safe_dump(data))


def test_warning_for_a_skew(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    k = K0.copy()
    k[0, 1] = 3.0
    read(tmp_path, yaml.safe_dump({"K": k.tolist(), "D": list(D0)}), size=SIZE)
    assert "the skew of the camera matrix, 3 px, is not used" in caplog.text


@pytest.mark.parametrize("suffix", ["yml", "xml"])
def test_names_of_opencv_2(tmp_path: Path, suffix: str) -> None:
    matrix = "6.1520e+002 0. 3.2110e+002 0. 6.1540e+002 2.3890e+002 0. 0. 1."
    distortion = "1.0e-002 -2.0e-002 1.0e-004 2.0e-004 0."
    yml = f"""%YAML:1.0
calibration_Time: "03/02/15 10:11:12"
image_Width: 640
image_Height: 480
board_Width: 9
board_Height: 6
Camera_Matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ {matrix.replace(" ", ", ")} ]
Distortion_Coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ {distortion.replace(" ", ", ")} ]
Avg_Reprojection_Error: 3.0e-001
"""
    xml = f"""<?xml version="1.0"?>
<opencv_storage>
<image_Width>640</image_Width>
<image_Height>480</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>{matrix}</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
  <data>{distortion}</data></Distortion_Coefficients>
</opencv_storage>
"""
    cam0 = read(tmp_path, {"yml": yml, "xml": xml}[suffix], f"out_camera_data.{suffix}").rig.cam0
    assert (cam0.width, cam0.height, cam0.fx, cam0.cy) == (640, 480, 615.2, 238.9)
    assert cam0.distortion == (0.01, -0.02, 1e-4, 2e-4, 0.0)


def test_projections_beside_an_opencv_pair_are_not_kitti(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    values = {"M1": K0, "D1": np.array([D0]), "M2": K1, "D2": np.array([D1])}
    values |= {"R": CAM1_FROM_CAM0[:3, :3], "T": CAM1_FROM_CAM0[:3, 3:4]}
    values |= {"P1": np.eye(3, 4), "P2": np.eye(3, 4), "Q": np.eye(4)}
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    calibration = read_calibration(path, SIZE)
    assert (calibration.kind, calibration.rig.is_stereo) == ("OpenCV", True)


@pytest.mark.parametrize("name", ["dist_coeffs", "distortion_coeffs", "D", "distortion"])
def test_spellings_in_sensor_yaml(tmp_path: Path, name: str) -> None:
    text = f"""T_BS: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
resolution: [640, 480]
camera_model: pinhole
intrinsics: [500, 501, 320.5, 239]
distortion_model: radial-tangential
{name}: [-0.28, 0.07, 0.0002, 1.8e-05]
"""
    calibration = read(tmp_path, text)
    assert (calibration.kind, calibration.rig.cam0.distortion) == ("EuRoC", D0[:4])
    message = read_error(tmp_path, text.replace(f"{name}: ", "bend: "))
    assert "intrinsics has no distortion beside it" in message
    text = text.replace(f"{name}: ", "bend: ").replace("radial-tangential", "none")
    assert read(tmp_path, text).rig.cam0.distortion_model == "none"


@pytest.mark.parametrize(
    "size",
    [
        {"image_size": [640, 480]},
        {"image_size": {"width": 640, "height": 480}},
        {"image_size": {"rows": 1, "cols": 2, "data": [640, 480]}},
        {"img_width": 640, "img_height": 480},
        {"Resolution": [640, 480]},
        {"W": 640, "H": 480},
    ],
)
def test_spellings_of_the_size(tmp_path: Path, size: dict[str, object]) -> None:
    data = {"mtx": K0.tolist(), "dist": list(D0)} | size
    cam0 = read(tmp_path, json.dumps(data), "c.json").rig.cam0
    assert (cam0.width, cam0.height) == (640, 480)


def test_a_camera_in_a_section(tmp_path: Path) -> None:
    camera = {"K": K0.tolist(), "dist_coeff": list(D0)}
    data = {"video": {"fps": 30}, "calibration": camera, "image_size": [640, 480]}
    calibration = read(tmp_path, json.dumps(data), "c.json")
    assert calibration.rig.cam0.distortion == D0
    data = {"front": camera, "rear": camera, "image_size": [640, 480]}
    message = read_error(tmp_path, json.dumps(data), "c.json")
    assert "sections front, rear each have a camera; name them left and right" in message
    data = {"cam0": camera, "cam1": {**camera, "K": K1.tolist()}, "image_size": [640, 480]}
    data |= {"extrinsics": {"R": np.eye(3).tolist(), "T": [-0.1, 0, 0]}}
    rig = read(tmp_path, json.dumps(data), "c.json").rig
    assert rig.cam1 is not None and (rig.cam0.fx, rig.cam1.fx) == (500.0, 510.0)
    assert cam1_from_cam0(rig)[0, 3] == -0.1


@pytest.mark.parametrize(
    "camera",
    [
        {"camera_matrix": {"fx": 500, "fy": 501, "cx": 320.5, "cy": 239}, "dist": list(D0)},
        {"fx": 500, "fy": 501, "cx": 320.5, "cy": 239, "distortion": list(D0)},
        {"fx": 500, "fy": 501, "ppx": 320.5, "ppy": 239, "coeffs": list(D0),
         "model": "distortion.brown_conrady"},
        {"fx": 500, "fy": 501, "cx": 320.5, "cy": 239, "k1": D0[0], "k2": D0[1], "p1": D0[2],
         "p2": D0[3], "k3": D0[4]},
    ],
)  # fmt: skip
def test_focal_lengths_and_principal_point(tmp_path: Path, camera: dict[str, object]) -> None:
    data = {"width": 640, "height": 480} | camera
    cam0 = read(tmp_path, json.dumps(data), "c.json").rig.cam0
    assert (cam0.fx, cam0.fy, cam0.cx, cam0.cy) == (500.0, 501.0, 320.5, 239.0)
    assert cam0.distortion == D0
    lost = {key: v for key, v in data.items() if key not in ("dist", "distortion", "coeffs")}
    lost = {key: v for key, v in lost.items() if key[0] not in "k" and key not in ("p1", "p2")}
    assert "has no distortion beside it" in read_error(tmp_path, json.dumps(lost), "c.json")


@pytest.mark.parametrize(
    ("model", "shown"),
    [
        ("Inverse Brown Conrady", "'Inverse Brown Conrady'"),
        ("RS2_DISTORTION_INVERSE_BROWN_CONRADY", "'RS2_DISTORTION_INVERSE_BROWN_CONRADY'"),
        ("distortion.modified_brown_conrady", "'distortion.modified_brown_conrady'"),
        (2, "2 (inversebrownconrady)"),
        (1, "1 (modifiedbrownconrady)"),
    ],
)
def test_a_model_of_realsense_that_is_ideal(tmp_path: Path, model: object, shown: str) -> None:
    data = {"width": 640, "height": 480, "fx": 380, "fy": 380, "ppx": 320, "ppy": 240}
    data |= {"model": model, "coeffs": [0, 0, 0, 0, 0]}
    assert read(tmp_path, json.dumps(data), "c.json").rig.cam0.distortion_model == "none"
    data["coeffs"] = [0.1, 0, 0, 0, 0]
    message = read_error(tmp_path, json.dumps(data), "c.json")
    assert f"model {shown} is not supported" in message
    assert "versions of RealSense's SDK distort by it, or undistort: calibrate the" in message


@pytest.mark.parametrize(
    ("model", "expected"),
    [(4, "radtan"), (5, "equidistant"), ("RS2_DISTORTION_KANNALA_BRANDT4", "equidistant"),
     ("KannalaBrandtK3", "equidistant"), ("BrownConrady", "radtan"), ("ELP-2MP", "radtan")],
)  # fmt: skip
def test_models_by_name_or_number(tmp_path: Path, model: object, expected: str) -> None:
    """RealSense's SDK has five coefficients for all models, Sophus has its own names."""
    data = {"width": 640, "height": 480, "fx": 380, "fy": 380, "ppx": 320, "ppy": 240}
    data |= {"model": model, "coeffs": [0.01, -0.002, 0.001, 0.0005, 0]}
    assert read(tmp_path, json.dumps(data), "c.json").rig.cam0.distortion_model == expected
