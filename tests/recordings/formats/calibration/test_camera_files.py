"""COLMAP's cameras.txt, DSO's camera.txt, and numpy archives."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration_files import COLMAP_HEADER, read, read_error

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import normalise
from vo.base.types import Camera
from vo.recordings.formats.calibration import read_calibration

COLMAP = {
    "SIMPLE_PINHOLE": ("600 320 240", (600, 600), "none", ()),
    "PINHOLE": ("600 601 320 240", (600, 601), "none", ()),
    "SIMPLE_RADIAL": ("600 320 240 -0.1", (600, 600), "radtan", (-0.1, 0, 0, 0)),
    "RADIAL": ("600 320 240 -0.1 0.02", (600, 600), "radtan", (-0.1, 0.02, 0, 0)),
    "OPENCV": ("600 601 320 240 .1 .2 .3 .4", (600, 601), "radtan", (0.1, 0.2, 0.3, 0.4)),
    "FULL_OPENCV": (
        "600 601 320 240 .7 .2 .03 .04 .1 .6 .3 .08", (600, 601), "radtan",
        (0.7, 0.2, 0.03, 0.04, 0.1, 0.6, 0.3, 0.08),
    ),
    "OPENCV_FISHEYE": ("600 601 320 240 1 2 3 4", (600, 601), "equidistant", (1, 2, 3, 4)),
    "SIMPLE_RADIAL_FISHEYE": ("600 320 240 0.1", (600, 600), "equidistant", (0.1, 0, 0, 0)),
    "RADIAL_FISHEYE": ("600 320 240 0.1 0.2", (600, 600), "equidistant", (0.1, 0.2, 0, 0)),
}  # fmt: skip
MONO_VO = "0.535719308 0.669566858 0.493248545 0.500408664 0.897966326\n1280 1024\n"
END = "0.4 0.53 0.5 0.5 0\n640 480\n"
SIZE = (640, 480)
MATRIX = np.array([[520.5, 0.0, 318.25], [0.0, 519.5, 241.75], [0.0, 0.0, 1.0]])
DISTORTION = np.array([[-0.31, 0.12, 0.001, -0.002, 0.0]])


@pytest.mark.parametrize("model", COLMAP)
def test_colmap(tmp_path: Path, model: str) -> None:
    parameters, focal, lens, coefficients = COLMAP[model]
    text = f"{COLMAP_HEADER}1 {model} 640 480 {parameters}\n"
    calibration = read(tmp_path, text, "cameras.txt")
    assert calibration.kind == "COLMAP"
    cam0 = calibration.rig.cam0
    assert (cam0.width, cam0.height, cam0.fx, cam0.fy) == (640, 480, *focal)
    # The centre of 640 pixels is 320 from the corner of the first pixel, 319.5 from its centre.
    assert (cam0.cx, cam0.cy) == (319.5, 239.5)
    assert (cam0.distortion_model, cam0.distortion) == (lens, coefficients)


def test_colmap_with_several_cameras(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    text = COLMAP_HEADER + "1 PINHOLE 640 480 600 600 320 240\n2 PINHOLE 800 600 700 700 400 300\n"
    assert read(tmp_path, text, "cameras.txt", (800, 600)).rig.cam0.fx == 700
    assert "only camera 2 of 2 is used" in caplog.text
    assert read(tmp_path, text, "cameras.txt").rig.cam0.fx == 600


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
    message = read_error(tmp_path, f"{COLMAP_HEADER}{line}\n", "cameras.txt")
    assert expected in message and "camera 1" in message
    assert message.endswith("(read as COLMAP calibration)")


def camera(tmp_path: Path, text: str) -> Camera:
    (tmp_path / "camera.txt").write_text(text, encoding="utf-8")
    calibration = read_calibration(tmp_path / "camera.txt")
    assert calibration.kind == "DSO"
    return calibration.rig.cam0


@pytest.mark.parametrize("omega", [0.897966326, 0.93, 0.5, 0.05, -0.9])
def test_fov_lens_undistorts_as_in_dso(tmp_path: Path, omega: float) -> None:
    found = camera(tmp_path, MONO_VO.replace("0.897966326", str(omega)) + END)
    fx, fy = 0.535719308 * 1280, 0.669566858 * 1024
    cx, cy = 0.493248545 * 1280 - 0.5, 0.500408664 * 1024 - 0.5
    u, v = np.meshgrid(np.linspace(0, 1279, 17), np.linspace(0, 1023, 13))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    x, y = (pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy
    radius = np.hypot(x, y)
    undistorted = np.tan(radius * omega) / (2 * np.tan(omega / 2))  # DSO, Undistort.cpp
    expected = np.stack([x, y], axis=1) * (undistorted / radius)[:, None]
    difference = np.linalg.norm(normalise(found, pixels) - expected, axis=1)
    # Angles, as the plane is stretched towards the sides.
    assert (difference / (1 + undistorted**2)).max() * fx < 0.1


def test_other_lenses(tmp_path: Path) -> None:
    found = camera(tmp_path, "RadTan 600 601 320 240 0.1 0.2 0.003 0.004\n640 480\ncrop\n640 480\n")
    assert (found.fx, found.cy, found.distortion_model) == (600, 240, "radtan")
    assert found.distortion[:4] == (0.1, 0.2, 0.003, 0.004)
    found = camera(
        tmp_path, "EquiDistant 0.5 0.6 0.5 0.5 0.1 0.2 0.003 0.004\n640 480\nfull\n1 1\n"
    )
    assert (found.fx, found.cx, found.distortion_model) == (320, 319.5, "equidistant")
    found = camera(tmp_path, "Pinhole 600 601 320 240 0\n640 480\nnone\n640 480\n")
    assert not found.is_distorted


@pytest.mark.parametrize(
    "text",
    [
        "0.4 0.5 0.5 0.5 1.55\n640 480\ncrop\n640 480\n",
        "KannalaBrandt 300 300 320 240 0.1 0.2 0.003 0.004\n640 480\ncrop\n640 480\n",
        "RadTan 600 601 320 240 0.1\n640 480\ncrop\n640 480\n",
    ],
)
def test_other_models_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(CalibrationError, match=r"camera\.txt: the .*(not supported|degrees)"):
        camera(tmp_path, text)


def saved(tmp_path: Path, **arrays: Any) -> Path:
    path = tmp_path / "calibration.npz"
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("matrix", "distortion"),
    [("mtx", "dist"), ("K", "D"), ("cameraMatrix", "distCoeffs"), ("camera_matrix", "dist_coefs")],
)
def test_usual_names_are_read(tmp_path: Path, matrix: str, distortion: str) -> None:
    vectors = np.zeros((20, 3, 1))
    arrays = {matrix: MATRIX, distortion: DISTORTION, "rvecs": vectors, "tvecs": vectors}
    camera = read_calibration(saved(tmp_path, ret=0.3, **arrays), SIZE).rig.cam0
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (520.5, 519.5, 318.25, 241.75)
    assert camera.distortion[:4] == (-0.31, 0.12, 0.001, -0.002)
    assert (camera.width, camera.height) == SIZE


def test_a_pair_is_read(tmp_path: Path) -> None:
    translation = np.array([[-0.12], [0.0], [0.0]])
    pair = {"M1": MATRIX, "D1": DISTORTION, "M2": MATRIX, "D2": DISTORTION, "R": np.eye(3)}
    rig = read_calibration(saved(tmp_path, **pair, T=translation), SIZE).rig
    assert rig.cam1_from_cam0 is not None
    assert rig.cam1_from_cam0[:3, 3] == pytest.approx([-0.12, 0.0, 0.0])


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> Any:
            return (Path.touch, (tmp_path / "boom",))

    path = saved(tmp_path, mtx=MATRIX, dist=np.array([Bomb()], dtype=object))
    with pytest.raises(CalibrationError):  # without distortion, a matrix is refused
        read_calibration(path, SIZE)
    assert not (tmp_path / "boom").exists()


@pytest.mark.parametrize(
    "shape",
    [
        "(10000000000000,)",
        "(3, 10000000000000)",
        "(-1,)",
        "(9,)",
        "(True, 9)",
        "(3.0, 3)",
        "[" * 900,
    ],
)
@pytest.mark.parametrize("version", [1, 2])
def test_an_array_that_states_more_than_it_has_is_left_out(
    tmp_path: Path, shape: str, version: int
) -> None:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    length = len(text).to_bytes(2 * version, "little")
    path = tmp_path / "calibration.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("mtx.npy", b"\x93NUMPY" + bytes([version, 0]) + length + text)
    with pytest.raises(CalibrationError, match="without a camera matrix"):
        read_calibration(path, SIZE)


def test_other_archives_are_refused_with_their_content(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"without a camera matrix .*: poses, stamps"):
        read_calibration(saved(tmp_path, poses=np.eye(4), stamps=np.arange(3)), SIZE)


def test_a_damaged_archive_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path, mtx=MATRIX, dist=DISTORTION)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(CalibrationError, match="damaged numpy archive"):
        read_calibration(path, SIZE)
