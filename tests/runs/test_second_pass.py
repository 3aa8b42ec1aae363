"""Runs whose lenses turn out to be wrong begin again with what is known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import vo

KITTI06 = """
cam0: {{resolution: [1226, 370], intrinsics: [707.0912, 707.0912, 601.8873, 183.1104],
  distortion_model: radtan, distortion: [{k1}, 0, 0, 0]}}
cam1: {{resolution: [1226, 370], intrinsics: [707.0912, 707.0912, 601.8873, 183.1104],
  distortion_model: radtan, distortion: [{k1}, 0, 0, 0]}}
cam1_from_cam0: [[1, 0, 0, -0.5371507], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


@pytest.mark.parametrize("k1", [-0.02, 0.03])
def test_a_pair_with_wrong_lenses_is_right_from_its_first_frame(
    shared_data: Path, tmp_path: Path, k1: float
) -> None:
    """51 frames, of which 22 to 26 were tracked before both were corrected: 0.085 and 0.094 m."""
    calibration = tmp_path / "calibration.yaml"
    calibration.write_text(KITTI06.format(k1=k1))
    source = shared_data / "kitti06_stereo_000-050"
    vo.run(source, tmp_path / "out", calibration=str(calibration))
    assert vo.evaluate(tmp_path / "out", source).ate.translation.rmse < 0.03
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["trusted"] and summary["frames"] == 51
    assert summary["lens_error"]["k1"] == pytest.approx(-k1, rel=0.4)
    assert len((tmp_path / "out" / "causal.tum").read_text().splitlines()) == 51
