"""Outputs stay out of recordings, and files of others are never replaced unasked."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from run_calls import vo_run
from typer.testing import CliRunner, Result

from vo.cli.app import app
from vo.outputs.results.output_paths import refuse_to_overwrite


def vo(*words: object) -> Result:
    return CliRunner().invoke(app, list(map(str, words)))


def assert_refused(result: Result, *parts: str) -> None:
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    for part in parts:
        assert part in errors[0]


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


@pytest.mark.parametrize(
    "words",
    [
        ["run", "images", "-o", "images/out"],
        ["run", "images", "-o", "out", "--ply", "images/map.ply"],
        ["run", "images", "-o", "out", "--rrd", "images/run.rrd"],
        ["run", "images", "-o", "out", "--mcap", "images/run.mcap"],
        ["run", "images", "-o", "out", "--colmap", "images/model"],
        ["info", "images", "--picture", "images/sheet.png"],
        ["features", "images", "--picture", "images/features.png"],
        ["features", "images", "--compare", "orb", "--picture", "images/plot.png"],
        ["convert", "images", "images/copy"],
        ["convert", "images", "images/copy.mcap"],
        ["calibrate", "images", "-o", "images/camera.yaml"],
        ["calibrate", "images", "--picture", "images/coverage.png"],
        ["eval", "estimate.tum", "images", "--picture", "images/errors.png"],
        ["vocabulary", "train", "images", "-o", "images/new.words"],
    ],
)
def test_nothing_is_written_inside_a_recording(
    words: list[str], images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(images.parent)
    Path("estimate.tum").write_text("0 0 0 0 0 0 0 1\n", encoding="utf-8")
    before = names_in(images.parent)
    assert_refused(vo(*words), "is inside the recording images", "such as images_")
    assert names_in(images.parent) == before


def test_a_run_in_the_folder_of_the_recording_proposes_a_place_beside_it(
    images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(images)
    assert_refused(vo("run", ".", "-o", "out"), "such as ../images_out")
    assert vo("run", ".", "-o", "../images_out", "-q").exit_code == 3  # of noise


def test_the_folder_of_an_earlier_run_is_no_part_of_a_recording(images: Path, out: Path) -> None:
    assert vo_run(images, out, "-q").exit_code == 3
    inside = images / "out"
    shutil.move(out, inside)
    assert vo_run(images, inside, "-q", "--ply", inside / "map.ply").exit_code == 3
    assert vo("report", inside, "-q").exit_code == 0
    assert (inside / "report.html").is_file()


def test_images_of_a_pattern_are_not_replaced(images: Path) -> None:
    pattern = images / "*.png"
    for name in ("0.png", "new.png"):  # the latter would be read by the next run
        refused = vo("info", pattern, "--picture", images / name)
        assert_refused(refused, "is an input and would be replaced")
    refuse_to_overwrite([pattern], [images / "out" / "sheet.png", images.parent / "0.png"])


@pytest.mark.parametrize(
    "words",
    [
        ["info", "images", "--picture", "link.png"],
        ["features", "images", "--picture", "link.png"],
        ["match", "images:0", "images:1", "--picture", "link.png"],
        ["markers", "images", "--length", "0.1", "--csv", "link.csv"],
        ["markers", "--print", "link.pdf", "--length", "0.1"],
        ["calibrate", "--print-board", "link.png", "--force"],
        ["calibrate", "images", "-o", "link.yaml", "--force"],
        ["convert", "images", "link.mcap", "--force"],
        ["vocabulary", "train", "images", "-o", "link.words"],
        ["run", "images", "-o", "out", "--loops", "--save-map", "link.vomap"],
        ["run", "images", "-o", "out", "--ply", "link.ply"],
    ],
)
def test_links_are_not_followed(
    words: list[str], images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(images.parent)
    link = next(Path(word) for word in words if word.startswith("link."))
    Path("mine").write_text("mine", encoding="utf-8")
    link.symlink_to("mine")
    assert_refused(vo(*words), f"{link} is a symbolic link, which is not followed")
    assert Path("mine").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("option", ["--rrd", "--mcap", "--ply", "--colmap"])
@pytest.mark.parametrize("read", ["--map", "--vocabulary"])
def test_a_map_and_a_vocabulary_are_not_replaced_by_another_output(
    read: str, option: str, images: Path, out: Path, tmp_path: Path
) -> None:
    path = tmp_path / "precious"
    path.write_text("mine", encoding="utf-8")
    refused = vo_run(images, out, "--loops", read, path, option, path)
    assert_refused(refused, "precious is an input and would be replaced")
    assert path.read_text(encoding="utf-8") == "mine"


def test_an_exported_map_does_not_replace_the_map(tmp_path: Path) -> None:
    path = tmp_path / "a.map"
    path.write_text("mine", encoding="utf-8")
    assert_refused(vo("map", "export", path, "-o", path), "is an input and would be replaced")
    assert path.read_text(encoding="utf-8") == "mine"


def test_a_calibration_is_replaced_only_when_asked_for(
    images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("calibration.yaml").write_text("mine", encoding="utf-8")
    assert_refused(vo("calibrate", images), "calibration.yaml exists already", "--force")
    assert_refused(vo("calibrate", "--print-board", "calibration.yaml"), "exists already")
    forced = vo("calibrate", images, "--force")
    assert forced.exit_code == 1 and "exists already" not in forced.stderr  # there is no board
    assert Path("calibration.yaml").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("y.mp4", ["videos cannot be written", "ffmpeg"]),
        ("y.MKV", ["videos cannot be written"]),
        ("y.bag", ["ROS bags cannot be written", "--to mcap-ros2"]),
    ],
)
def test_convert_says_what_it_cannot_write(
    name: str, parts: list[str], images: Path, tmp_path: Path
) -> None:
    assert_refused(vo("convert", images, tmp_path / name), name, *parts)
    assert not (tmp_path / name).exists()


def test_a_synthetic_recording_with_results_is_not_replaced(tmp_path: Path) -> None:
    recording = tmp_path / "street"
    recording.mkdir()
    (recording / "recipe.yaml").write_text("", encoding="utf-8")
    run = recording / "run"
    run.mkdir()
    (run / "summary.json").write_text("{}", encoding="utf-8")
    refused = vo("synth", recording, "--seconds", "1", "--force")
    assert_refused(refused, "is not replaced", str(run))
    assert_refused(vo("synth", recording / "more"), "is inside the recording")


def test_a_report_is_written_into_the_folder_of_its_run(
    images: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert vo_run(images, out, "-q").exit_code == 3
    monkeypatch.chdir(tmp_path)
    printed = vo("report", out, "--json")
    assert printed.exit_code == 0, printed.output
    page = out / "report.html"
    assert json.loads(printed.stdout) == {"report": str(page), "pictures": [], "runs": [str(out)]}
    assert page.is_file()
    assert vo("report", out, out, "-q").stdout == ""
    assert Path("report.html").is_file()
    assert_refused(vo("report", out, "-o", out / "summary.json"), "is not a report")
    assert_refused(vo("report", out, "-o", images / "r.html"), "is inside the recording")
