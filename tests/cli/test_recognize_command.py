"""`vo recognize` from the command line."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from object_samples import pose, scene, stored
from typer.testing import CliRunner, Result

from vo.cli.app import app

CALIBRATION = "cam0: {resolution: [640, 480], intrinsics: [600, 600, 319.5, 239.5]}\n"


def recognize(*words: object) -> Result:
    return CliRunner().invoke(app, ["recognize", *map(str, words)], catch_exceptions=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images of objects, a database of two, a scene, and a recording of four frames."""
    place = tmp_path_factory.mktemp("recognize")
    for number in range(3):
        cv2.imwrite(str(place / f"print{number}.png"), stored(number))
    cv2.imwrite(str(place / "blank.png"), np.full((200, 200), 90, np.uint8))
    cv2.imwrite(str(place / "empty.png"), scene(seed=4))
    cv2.imwrite(str(place / "scene.png"), scene((0, pose(0.05, 0, 0.6, 20.0))))
    (place / "camera.yaml").write_text(CALIBRATION, encoding="utf-8")
    walk = place / "walk"
    walk.mkdir()
    for frame in range(4):
        moved = (0, pose(-0.1 + 0.03 * frame, 0.0, 0.7, 20.0))
        placed = [moved] if frame < 2 else [moved, (1, pose(0.17, 0.12, 0.8))]
        cv2.imwrite(str(walk / f"{frame}.png"), scene(*placed))
    (walk / "times.txt").write_text("0.0\n0.1\n0.2\n0.3\n", encoding="utf-8")
    words = ("--database", place / "two.vodb")
    for number, width in ((0, "0.2"), (1, "0.2")):
        image = place / f"print{number}.png"
        result = recognize("add", f"print{number}", image, "--width", width, *words)
        assert result.exit_code == 0, result.output
    assert "two.vodb has 2 objects" in result.stdout
    return place


def test_an_image_is_searched(folder: Path, tmp_path: Path) -> None:
    picture = tmp_path / "found.png"
    words = ["find", folder / "scene.png", "-d", folder / "two.vodb", "--picture", picture]
    result = recognize(*words, "--calibration", folder / "camera.yaml")
    assert result.exit_code == 0, result.output
    assert "print0: confidence" in result.stdout
    place = re.search(r"at x (\S+), y (\S+), z (\S+) m", result.stdout)
    assert place is not None
    assert [float(each) for each in place.groups()] == pytest.approx([0.05, 0, 0.6], abs=0.005)
    assert cv2.imread(str(picture)).shape == (480, 640, 3)
    found = json.loads(recognize(*words, "--json").stdout)
    (each,) = found["frames"][0]["objects"]
    assert each["name"] == "print0"
    assert each["cam_from_object"] is None
    assert len(each["outline"]) == 4


def test_objects_are_followed_through_a_recording(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "found.csv"
    words = ["find", folder / "walk", "-d", folder / "two.vodb", "--csv", table]
    result = recognize(*words, "--calibration", folder / "camera.yaml")
    assert result.exit_code == 0, result.output
    assert "print0 (0): 4 of 4 frames, 0 to 3" in result.stdout
    assert "print1 (1): 2 of 4 frames, 2 to 3" in result.stdout
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert [(row["frame"], row["track"], row["name"]) for row in rows if row["track"] == "0"] == [
        (str(frame), "0", "print0") for frame in range(4)
    ]
    depths = [float(row["tz"]) for row in rows if row["track"] == "0"]
    assert depths == pytest.approx([depths[0]] * 4, abs=0.01)
    without = recognize(*words[:-2], "--end", "1", "--json")  # without a calibration
    assert json.loads(without.stdout)["tracks"][0]["frames"] == 1


def test_nothing_known_is_status_1(folder: Path) -> None:
    result = recognize("find", folder / "empty.png", "-d", folder / "two.vodb")
    assert result.exit_code == 1
    assert "no known object in" in result.stdout


def test_objects_are_listed_and_removed(folder: Path, tmp_path: Path) -> None:
    database = tmp_path / "own.vodb"
    database.write_bytes((folder / "two.vodb").read_bytes())
    result = recognize("list", "-d", database)
    assert result.exit_code == 0
    assert "2 objects, features of sift" in result.stdout
    assert "sides 1, 0.2 m wide" in result.stdout
    assert recognize("remove", "print0", "-d", database).exit_code == 0
    listed = json.loads(recognize("list", "-d", database, "--json").stdout)
    assert [each["name"] for each in listed["objects"]] == ["print1"]
    assert recognize("remove", "print1", "-d", database).exit_code == 0
    result = recognize("find", folder / "scene.png", "-d", database)
    assert result.exit_code == 1
    assert "has no objects; add some with" in result.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["add", "new", "blank.png"], "has too little texture"),
        (["add", "print0", "print2.png"], "there is an object 'print0' already"),
        (["add", "new", "missing.png"], "missing.png"),
        (["add", "new", "print2.png", "--detector", "orb"], "has features of sift, not orb"),
        (["add", "new", "print2.png", "--width", "200"], "the width is 200 m; give metres"),
        (["add", "new"], "1 words after add; give vo recognize add NAME IMAGE"),
        (["list", "x"], "1 words after list"),
        (["remove", "x"], "there is no object 'x' in the database; there are: print0, print1"),
        (["find", "scene.png", "--width", "1"], "--width belongs to"),
        (["list", "--picture", "x.png"], "--picture belongs to"),
        (["find", "scene.png", "--picture", "x.gif"], "must end in .png"),
        (["find", "scene.png", "-d", "print0.png"], "is no database of objects"),
        (["find", "scene.png", "-d", "none.vodb"], "cannot read the database"),
        (["find", "scene.png", "--csv", "scene.png"], "is an input and would be replaced"),
        (["find", "none.png"], "none.png"),
        (["find", "walk", "--start", "9"], "the recording has only 4 frames"),
    ],
)
def test_wrong_calls_are_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    monkeypatch.chdir(folder)
    before = (folder / "two.vodb").read_bytes()
    database = [] if "-d" in words else ["-d", "two.vodb"]
    result = recognize(*words, *database)
    assert result.exit_code == 1, result.output
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    assert message in result.stderr
    assert (folder / "two.vodb").read_bytes() == before


def test_a_calibration_of_another_size_is_refused(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "camera.yaml"
    small = "cam0: {resolution: [320, 240], intrinsics: [300, 300, 159.5, 119.5]}\n"
    other.write_text(small, encoding="utf-8")
    words = ["find", folder / "scene.png", "-d", folder / "two.vodb", "--calibration", other]
    result = recognize(*words)
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1


def test_images_and_folders_are_searched_together(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "found.csv"
    words = ("find", folder / "scene.png", folder / "walk", "-d", folder / "two.vodb")
    result = recognize(*words, "--csv", table, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["sources"]
    assert [Path(each["source"]).name for each in found] == [
        "scene.png",
        *(f"{number}.png" for number in range(4)),
    ]
    counts = [len(each["frames"][0]["objects"]) for each in found]
    assert counts == [1, 1, 1, 2, 2]
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert [Path(row["source"]).name for row in rows].count("3.png") == 2
    text = recognize(*words)
    assert str(folder / "walk" / "3.png") in text.stdout
    refused = recognize(*words, "--video", tmp_path / "a.mp4")
    assert refused.exit_code == 1 and "of one recording" in refused.stderr


def test_a_recording_is_drawn_as_a_video_with_names(folder: Path, tmp_path: Path) -> None:
    video = tmp_path / "named.mp4"
    words = ("find", folder / "walk", "-d", folder / "two.vodb", "--video", video)
    assert recognize(*words).exit_code == 0
    read = cv2.VideoCapture(str(video))
    assert int(read.get(cv2.CAP_PROP_FRAME_COUNT)) == 4
    picture = read.read()[1].astype(int)
    read.release()
    assert (picture.max(axis=2) - picture.min(axis=2) > 60).sum() > 200  # coloured lines
