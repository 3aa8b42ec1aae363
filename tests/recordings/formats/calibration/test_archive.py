"""Calibrations in numpy archives, as scripts after OpenCV's tutorials save them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vo.base.errors import CalibrationError
from vo.recordings.formats.calibration import read_calibration

SIZE = (640, 480)
MATRIX = np.array([[520.5, 0.0, 318.25], [0.0, 519.5, 241.75], [0.0, 0.0, 1.0]])
DISTORTION = np.array([[-0.31, 0.12, 0.001, -0.002, 0.0]])


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


def test_other_archives_are_refused_with_their_content(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"without a camera matrix .*: poses, stamps"):
        read_calibration(saved(tmp_path, poses=np.eye(4), stamps=np.arange(3)), SIZE)


def test_a_damaged_archive_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path, mtx=MATRIX, dist=DISTORTION)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(CalibrationError, match="damaged numpy archive"):
        read_calibration(path, SIZE)
