"""COLMAP's cameras.txt."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibration_files import COLMAP_HEADER, read, read_error

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
