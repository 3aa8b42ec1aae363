"""Runs whose lenses turn out to be wrong begin again with what is known."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
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


def test_the_right_camera_tracks_where_the_left_lens_is_fogged(
    shared_data: Path, tmp_path: Path
) -> None:
    """The left lens fogs from frame 20 on; by the left camera the path has 0.04 m, not trusted."""
    hall, folder = shared_data / "rendered_hall_stereo", tmp_path / "hall"
    shutil.copytree(hall, folder)
    rng = np.random.default_rng(0)
    for number, file in enumerate(sorted((folder / "mav0" / "cam0" / "data").iterdir())):
        clear = 1.0 - 0.93 * float(np.clip((number - 20) / 40, 0.0, 1.0))
        image = cv2.GaussianBlur(cv2.imread(str(file), 0), (0, 0), 0.3 + 3.0 * (1.0 - clear))
        hazy = image * clear + 150.0 * (1.0 - clear) + rng.normal(0.0, 1.5, image.shape)
        cv2.imwrite(str(file), np.clip(hazy, 0.0, 255.0).round().astype(np.uint8))
    vo.run(folder, tmp_path / "out", end=140, imu=False)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [fault["kind"] for fault in summary["faults"]] == ["right_camera_alone"]
    assert summary["trusted"] and summary["tracked"] == 140
    assert vo.evaluate(tmp_path / "out", folder).ate.translation.rmse < 0.007
