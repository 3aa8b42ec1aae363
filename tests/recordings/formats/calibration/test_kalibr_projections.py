"""Kalibr's projection models other than pinhole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from calibration_files import read, read_error


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
    cam0 = read(tmp_path, text, "camchain.yaml").rig.cam0
    assert (cam0.fx, cam0.fy, cam0.cx, cam0.cy) == (317.5, 316.1, 724.8, 546.5)
    assert (cam0.distortion_model, cam0.distortion) == expected
    wrong = text.replace(f"distortion_model: {lens}", "distortion_model: equidistant")
    wrong = wrong.replace(f"distortion_coeffs: {coefficients}", "distortion_coeffs: [1, 2, 3, 4]")
    assert f"camera model {model} with distortion model equidistant" in read_error(tmp_path, wrong)
