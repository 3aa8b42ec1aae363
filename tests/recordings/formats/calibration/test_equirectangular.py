"""360° cameras in files of several programs."""

from __future__ import annotations

from pathlib import Path

import pytest

from vo.base.errors import CalibrationError
from vo.base.geometry.cameras import equirectangular
from vo.base.types import Rig
from vo.recordings.formats.calibration import read_calibration, write_calibration

FILES = {
    "vo": "cam0: {resolution: [1920, 960], model: equirectangular}",
    "stella_vslam": "Camera: {name: Theta, setup: monocular, model: equirectangular, fps: 30.0, "
    "cols: 1920, rows: 960, color_order: RGB}",
    "OpenSfM": '{"v2 theta": {"projection_type": "spherical", "width": 1920, "height": 960}}',
}


@pytest.mark.parametrize("kind", FILES)
def test_an_equirectangular_camera_needs_no_numbers(kind: str, tmp_path: Path) -> None:
    file = tmp_path / ("camera.json" if kind == "OpenSfM" else "camera.yaml")
    file.write_text(FILES[kind])
    calibration = read_calibration(file)
    assert calibration.kind == kind
    assert calibration.rig.cam0 == equirectangular(1920, 960)


def test_it_is_written_and_read_again(tmp_path: Path) -> None:
    write_calibration(tmp_path / "c.yaml", Rig(equirectangular(1024, 512)))
    assert read_calibration(tmp_path / "c.yaml").rig.cam0 == equirectangular(1024, 512)


def test_a_focal_length_beside_it_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(
        "cam0: {resolution: [64, 32], model: equirectangular, intrinsics: [1, 1, 1, 1]}"
    )
    with pytest.raises(CalibrationError, match="intrinsics"):
        read_calibration(file)
