"""`camera.txt` of DSO and of the TUM monoVO data set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import normalise
from vo.base.types import Camera
from vo.recordings.formats.calibration import read_calibration

MONO_VO = "0.535719308 0.669566858 0.493248545 0.500408664 0.897966326\n1280 1024\n"
END = "0.4 0.53 0.5 0.5 0\n640 480\n"


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
