"""`vo match` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
from two_images import layered_pair, texture
from typer.testing import CliRunner, Result

from vo.cli.app import app

CALIBRATION = "cam0: {resolution: [320, 240], intrinsics: [300, 300, 159.5, 119.5]}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two images with a calibration: also a recording of two frames."""
    place = tmp_path / "walk"
    place.mkdir()
    for name, image in zip("ab", layered_pair(), strict=True):
        cv2.imwrite(str(place / f"{name}.png"), image)
    (place / "calibration.yaml").write_text(CALIBRATION, encoding="utf-8")
    (place / "times.txt").write_text("0.0\n0.1\n", encoding="utf-8")
    return place


def match(*words: object) -> Result:
    return CliRunner().invoke(app, ["match", *map(str, words)], catch_exceptions=False)


def test_files_have_a_model_and_with_a_calibration_a_motion(folder: Path) -> None:
    images = folder / "a.png", folder / "b.png"
    result = match(*images)
    assert result.exit_code == 0, result.output
    assert "fundamental matrix" in result.stdout
    assert "unknown without a calibration" in result.stdout
    result = match(*images, "--calibration", folder / "calibration.yaml")
    assert result.exit_code == 0
    for word in ("essential matrix", "rotation", "length unknown", "parallax", " ms"):
        assert word in result.stdout


def test_frames_of_a_recording_bring_their_calibration(folder: Path, tmp_path: Path) -> None:
    picture = tmp_path / "ab.png"
    words = ["--picture", picture, "--epipolar", "--json", "--detector", "sift"]
    result = match(f"{folder}:0", f"{folder}:1", *words)
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert record["model"]["kind"] == "essential"
    assert record["pose"]["has_translation"]
    assert record["picture"] == str(picture)
    assert record["images"][1]["name"] == f"{folder}:1"
    assert cv2.imread(str(picture)) is not None


def test_masked_parts_have_no_features(folder: Path, tmp_path: Path) -> None:
    images = folder / "a.png", folder / "b.png"
    counts = []
    for words in ([], ["--ignore", "0,0,160,240"], ["--roi", "0,0,320,80"]):
        found = match(*images, *words, "--detector", "sift", "--json")
        record = json.loads(found.stdout)
        counts.append([image["keypoints"] for image in record["images"]])
    assert max(counts[1]) < 0.85 * min(counts[0]) and max(counts[2]) < 0.6 * min(counts[0])
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), layered_pair()[0][:99])
    result = match(*images, "--mask", mask)
    assert result.exit_code == 1
    assert "320x99" in result.stderr and result.stderr.count("\n") == 1


def test_quiet_prints_failures_only(folder: Path, tmp_path: Path) -> None:
    assert match(folder / "a.png", folder / "b.png", "-q").output == ""
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), layered_pair()[0] * 0)
    result = match(folder / "a.png", black, "-q")
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == "no model: 0 matches, 8 needed\n"
    record = json.loads(match(folder / "a.png", black, "--json").stdout)
    assert record["failure"] == "0 matches, 8 needed"


def test_unrelated_images_have_no_model(tmp_path: Path) -> None:
    for seed in (3, 4):
        cv2.imwrite(str(tmp_path / f"{seed}.png"), texture(seed, 240, 320))
    words = (tmp_path / "3.png", tmp_path / "4.png", "--detector", "sift", "--ratio", 0.95)
    result = match(*words)
    assert result.exit_code == 1
    assert "no model: the images share no geometry that is better than chance:" in result.stdout
    result = match(*words, "--json")
    record = json.loads(result.stdout)
    assert result.exit_code == 1 and record["model"] is None
    assert record["failure_reason"] == "no_consensus"
    assert record["chance"]["inliers"] < record["chance"]["needed"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.png", "none.png"], "image none.png does not exist"),
        (["a.png", "."], "give .:NUMBER"),
        (["a.png", "calibration.yaml"], "not an image"),
        ([".:0", ".:2"], ". has frames 0 to 1, no frame 2"),
        ([".:0", ".:1", "--right"], "no right images"),
        (["a.png", "b.png", "--right"], "give its calibration"),
        (["a.png", "b.png", "--model", "e"], "needs the calibration"),
        (["a.png", "b.png", "--epipolar"], "--picture"),
        (["a.png", "b.png", "--picture", "a.png"], "would be replaced"),
        (["a.png", "b.png", "--picture", "../x.bmp"], "must end in .png"),
        ([".:0", ".:1", "--picture", "x.png"], "inside the recording"),
        (["a.png", "b.png", "--detector", "sitf"], "features.detector"),
        (["a.png", "b.png", "--set", "features.count=1"], "features.count"),
        (["a.png", "b.png", "--threshold", "0"], "threshold"),
    ],
)
def test_wrong_input_is_one_line(
    words: list[str], message: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    result = match(*words)
    assert result.exit_code == 1
    assert result.stdout == ""
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert message in lines[0]
