"""Recordings without a calibration: the camera is estimated, said, and written to a file."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.recipe import load_recipe
from data_synth.sequence import make_sequence
from vo.base.types import Rig
from vo.cli.app import app
from vo.recordings.formats.calibration import read_calibration, write_calibration


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Images of the left camera of a walk, without calibration, and the recording they are of."""
    root = tmp_path_factory.mktemp("uncalibrated")
    settings = ["motion=handheld", "seconds=6", "speed=1.0", "scale=0.625", "effects.exposure=0"]
    whole = root / "whole"
    make_sequence(whole, load_recipe("demo", settings))
    folder = root / "images"
    shutil.copytree(whole / "mav0" / "cam0" / "data", folder)
    return folder, whole


def run_on(folder: Path, output: Path, *options: str) -> tuple[int, str, dict[str, object]]:
    result = CliRunner().invoke(app, ["run", str(folder), "-o", str(output), *options])
    summary = output / "summary.json"
    return (
        result.exit_code,
        result.stderr,
        json.loads(summary.read_text()) if summary.exists() else {},
    )


def test_the_camera_of_images_without_calibration_is_estimated(
    images: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, whole = images
    status, text, summary = run_on(folder, tmp_path / "out")
    truth = read_calibration(whole / "calibration.yaml").rig.cam0
    assert status == 0
    assert "no calibration: focal length and distortion are estimated first" in text
    found = summary["estimated_camera"]
    assert isinstance(found, dict)
    assert found["focal_px"] == pytest.approx(truth.fx, rel=0.01)
    assert found["cx"] == pytest.approx(truth.cx, abs=0.02 * truth.width)
    assert abs(found["focal_px"] - truth.fx) < 3.0 * found["sigma_px"]
    assert summary["trusted"] is True
    assert any("was estimated without a calibration" in each for each in summary["warnings"])  # type: ignore[attr-defined]
    # The file that is written gives the same path, without an estimate.
    file = tmp_path / "out" / "estimated_calibration.yaml"
    saved = tmp_path / "saved.yaml"
    options = ("--calibration", str(file), "--save-calibration", str(saved))
    status, text, again = run_on(folder, tmp_path / "again", *options)
    assert status == 0
    assert read_calibration(saved).rig.cam0 == read_calibration(file).rig.cam0
    assert again["estimated_camera"] is None
    assert not (tmp_path / "again" / "estimated_calibration.yaml").exists()
    same = [(tmp_path / each / "trajectory.tum").read_bytes() for each in ("out", "again")]
    assert same[0] == same[1]


def test_a_wrong_focal_length_is_found_and_replaced(
    images: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, whole = images
    camera = read_calibration(whole / "calibration.yaml").rig.cam0
    file = tmp_path / "wrong.yaml"
    wrong = replace(camera, fx=1.06 * camera.fx, fy=1.06 * camera.fy)
    write_calibration(file, Rig(wrong))
    status, _, summary = run_on(folder, tmp_path / "out", "--calibration", str(file))
    assert status == 0
    said = f"the calibration is wrong: its focal length is {wrong.fx:.1f} px"
    assert said in str(summary["warnings"])
    found = summary["estimated_camera"]
    assert isinstance(found, dict)
    assert found["focal_px"] == pytest.approx(camera.fx, rel=0.01)
    assert summary["trusted"] is True
    used = read_calibration(tmp_path / "out" / "estimated_calibration.yaml").rig.cam0
    assert used.fx == pytest.approx(camera.fx, rel=0.01)
    write_calibration(file, Rig(camera))
    _, _, summary = run_on(folder, tmp_path / "right", "--calibration", str(file))
    assert "the calibration is wrong" not in str(summary["warnings"])
    assert summary["estimated_camera"] is None


def test_a_camera_that_only_turns_shows_no_focal_length(tmp_path: Path) -> None:
    folder = tmp_path / "turning"
    folder.mkdir()
    rng = np.random.default_rng(2)
    wide = cv2.GaussianBlur(rng.integers(0, 255, (240, 900), dtype=np.uint8), (0, 0), 2.0)
    for number in range(30):  # a panorama slides by: no parallax
        cv2.imwrite(str(folder / f"{number:03d}.png"), wide[:, 8 * number : 8 * number + 320])
    status, text, summary = run_on(folder, tmp_path / "out")
    assert status in (1, 3) or summary["trusted"] is False
    if status == 1:
        assert "no calibration found" in text
        assert "cannot be estimated from the images" in text
        assert "Traceback" not in text


def test_a_pair_is_estimated_where_its_baseline_is_given(
    images: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of the left camera, the first test above has tried all guesses; here two of the eight do.
    monkeypatch.setattr("vo.runs.camera_estimation._FIELDS_DEG", (80.0,))
    folder, whole = images
    pair = tmp_path / "pair"
    shutil.copytree(folder, pair / "left")
    shutil.copytree(whole / "mav0" / "cam1" / "data", pair / "right")
    status, text, _ = run_on(pair, tmp_path / "out")
    assert status == 1
    assert "no calibration found" in text
    assert "--set camera.baseline_m=0.12" in " ".join(text.split())
    rig = read_calibration(whole / "calibration.yaml").rig
    assert rig.cam1 is not None and rig.cam1_from_cam0 is not None
    baseline_m = float(np.linalg.norm(rig.cam1_from_cam0[:3, 3]))
    options = ("--no-loops", "--set", f"camera.baseline_m={baseline_m}")
    status, text, summary = run_on(pair, tmp_path / "out", *options)
    assert status == 0, text
    assert summary["mode"] == "stereo"
    assert summary["trusted"] is True
    found = read_calibration(tmp_path / "out" / "estimated_calibration.yaml").rig
    assert found.cam1 is not None and found.cam1_from_cam0 is not None
    assert found.cam1.fx == pytest.approx(rig.cam1.fx, rel=0.02)
    error = found.cam1_from_cam0[:3, :3] @ rig.cam1_from_cam0[:3, :3].T
    assert np.degrees(np.linalg.norm(cv2.Rodrigues(error)[0])) < 0.5
    result = CliRunner().invoke(app, ["eval", str(tmp_path / "out"), str(whole), "--json"])
    assert json.loads(result.stdout)["ate"]["translation_m"]["rmse"] < 0.05
