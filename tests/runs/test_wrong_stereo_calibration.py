"""Runs on recordings whose right camera is not as its calibration says."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from vo.base.config import load_config
from vo.base.types import Floats
from vo.recordings.formats.trajectory import read_tum
from vo.runs.run_recording import run


def _with_right_camera(source: Path, folder: Path, **change: float) -> Path:
    """A copy whose calibration is wrong in the right camera.

    In its angles (degrees), focal length (a factor) or the centre of its image (pixels).
    """
    copy = Path(shutil.copytree(source, folder))
    path = copy / "mav0" / "cam1" / "sensor.yaml"
    camera = yaml.safe_load(path.read_text(encoding="utf-8"))
    angles = [change.get(axis, 0.0) for axis in ("pitch", "yaw", "roll")]
    turn, _ = cv2.Rodrigues(np.deg2rad(angles))
    body_from_camera = np.reshape(camera["T_BS"]["data"], (4, 4))
    body_from_camera[:3, :3] = body_from_camera[:3, :3] @ turn
    camera["T_BS"]["data"] = body_from_camera.ravel().tolist()
    for axis in (0, 1):
        camera["intrinsics"][axis] *= change.get("focal", 1.0)
    camera["intrinsics"][2] += change.get("centre", 0.0)
    path.write_text(yaml.safe_dump(camera), encoding="utf-8")
    return copy


def _summary(source: Path, output: Path, *settings: str) -> dict[str, Any]:
    run(source, output, config=load_config("default", settings))
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(summary, dict)
    return summary


def _scale(output: Path, source: Path) -> float:
    """Extent of the estimated path against that of the true one."""
    estimate, true = read_tum(output / "trajectory.tum"), read_tum(source / "groundtruth.tum")
    assert len(estimate) == len(true)
    return _extent(estimate.positions) / _extent(true.positions)


def _extent(positions: Floats) -> float:
    return float(np.linalg.norm(positions - positions.mean(axis=0)))


@pytest.mark.parametrize(
    ("change", "found", "amount"),
    [
        ({"pitch": 1.0}, "pitch_deg", -1.0),
        ({"roll": 0.5}, "roll_deg", 0.5),
        ({"focal": 1.01}, "zoom_percent", -1.0),
        ({"yaw": 0.2}, "yaw_deg", 0.2),
    ],
    ids=["pitch", "roll", "focal", "yaw"],
)
def test_lengths_stay_right_and_the_fault_is_told(
    synthetic_stereo: Path, tmp_path: Path, change: dict[str, float], found: str, amount: float
) -> None:
    source = _with_right_camera(synthetic_stereo, tmp_path / "wrong", **change)
    summary = _summary(source, tmp_path / "out")
    assert summary["tracked"] == 30
    assert _scale(tmp_path / "out", source) == pytest.approx(1.0, abs=0.01)
    assert summary["right_camera"][found] == pytest.approx(amount, abs=0.03)
    (sentence,) = summary["warnings"]
    assert "the right camera differs from its calibration" in sentence
    assert "vo calibrate" in sentence


def test_a_camera_that_looks_sideways_behind_a_centre_that_makes_up_for_it(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    # Right in the middle of the image: no offset, but disparities that err towards the sides.
    yaw_deg = 0.5
    path = synthetic_stereo / "mav0" / "cam1" / "sensor.yaml"
    focal = float(yaml.safe_load(path.read_text(encoding="utf-8"))["intrinsics"][0])
    yaw_px = float(focal * np.tan(np.deg2rad(yaw_deg)))
    source = _with_right_camera(synthetic_stereo, tmp_path / "wrong", yaw=yaw_deg, centre=yaw_px)
    summary = _summary(source, tmp_path / "out")
    assert summary["disparity_offset_px"] == 0.0
    assert summary["disparity_curve_px"] == pytest.approx(-yaw_px, rel=0.03)
    (sentence,) = summary["warnings"]
    assert "disparities on the left and right were wrong" in sentence
    assert _scale(tmp_path / "out", source) == pytest.approx(1.0, abs=0.003)
    _summary(source, tmp_path / "uncorrected", "refinement.disparity_correction=false")
    assert _scale(tmp_path / "uncorrected", source) > 1.03


def test_without_the_correction_lengths_would_be_wrong(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    source = _with_right_camera(synthetic_stereo, tmp_path / "wrong", focal=1.01)
    # What would correct it otherwise.
    changes = "stereo.row_correction=false", "refinement.lens_correction=false"
    summary = _summary(source, tmp_path / "out", *changes)
    assert summary["right_camera"] is None
    assert abs(_scale(tmp_path / "out", source) - 1.0) > 0.05


def test_nothing_is_told_of_a_camera_that_is_right(synthetic_stereo: Path, tmp_path: Path) -> None:
    summary = _summary(synthetic_stereo, tmp_path)
    assert summary["right_camera"] is None
    assert summary["warnings"] == []


def test_the_path_does_not_depend_on_threads(synthetic_stereo: Path, tmp_path: Path) -> None:
    source = _with_right_camera(synthetic_stereo, tmp_path / "wrong", yaw=0.2, roll=0.5)
    paths = []
    for threads in (1, 2, 4):
        _summary(source, tmp_path / str(threads), f"threads={threads}")
        paths.append((tmp_path / str(threads) / "trajectory.tum").read_bytes())
    assert paths[0] == paths[1] == paths[2]
