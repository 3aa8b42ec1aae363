"""`vo calibrate` on image folders: output files, JSON, and error messages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from board_images import poses_around, render
from typer.testing import CliRunner, Result

import vo
from vo.base.types import Camera
from vo.cli.app import app
from vo.recordings.formats.calibration import read_calibration
from vo.tools.calibrating.board import make_board

CAMERA = Camera(320, 240, 230.0, 229.0, 162.0, 118.0, "radtan", (-0.1, 0.02, 0.0, 0.0))
BOARD = make_board("charuco", 5, 4, 0.04)
WORDS: Any = {"board": "charuco", "columns": 5, "rows": 4, "square": 0.04}
OPTIONS = ["--board", "charuco", "--columns", "5", "--rows", "4", "--square", "0.04"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    for number, pose in enumerate(poses_around(BOARD, CAMERA, 10)):
        cv2.imwrite(str(folder / f"{number:03}.png"), render(BOARD, CAMERA, pose))
    return folder


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["calibrate", *map(str, words)])


def assert_one_line(result: Result, part: str) -> None:
    assert result.exit_code == 1
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert part in errors[0]


def test_writes_calibration_and_picture(recording: Path, tmp_path: Path) -> None:
    output, picture = tmp_path / "calibration.yaml", tmp_path / "coverage.png"
    result = run(recording, *OPTIONS, "-o", output, "--picture", picture, "--json")
    assert result.exit_code == 0, result.stderr
    figures = json.loads(result.stdout)
    camera = read_calibration(output, None).rig.cam0
    assert camera.fx == figures["cam0"]["parameters"]["fx"]["value"]
    assert camera.fx == pytest.approx(CAMERA.fx, rel=0.02)
    assert cv2.imread(str(picture)).shape[1] == 1200
    found = vo.calibrate(recording, tmp_path / "b.yaml", picture=tmp_path / "b.png", **WORDS)
    assert found.rig.cam0.fx == camera.fx
    assert (tmp_path / "b.yaml").read_bytes() == output.read_bytes()
    assert (tmp_path / "b.png").read_bytes() == picture.read_bytes()


def test_wrong_columns_are_reported(recording: Path) -> None:
    assert_one_line(run(recording, *OPTIONS, "--columns", "7"), "--columns and --rows")


@pytest.mark.parametrize(
    ("given", "suggestion"),
    [
        (["--columns", "4", "--rows", "5"], "--columns 5 --rows 4?"),
        (["--columns", "6", "--rows", "5"], "--columns 5 --rows 4?"),
        (["--board", "chessboard"], "--board charuco"),
    ],
    ids=["swapped", "squares", "kind"],
)
def test_the_actual_board_is_suggested(recording: Path, given: list[str], suggestion: str) -> None:
    assert_one_line(run(recording, *OPTIONS, *given), suggestion)


def test_mirrored_images_are_reported(recording: Path, tmp_path: Path) -> None:
    for path in recording.glob("*.png"):
        cv2.imwrite(str(tmp_path / path.name), cv2.imread(str(path))[:, ::-1])
    assert_one_line(run(tmp_path, *OPTIONS), "images are mirrored")


def test_a_chessboard_is_suggested_instead_of_charuco(tmp_path: Path) -> None:
    board = make_board("chessboard", 6, 4, 0.04)
    for number, pose in enumerate(poses_around(board, CAMERA, 3)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), render(board, CAMERA, pose))
    assert_one_line(run(tmp_path, *OPTIONS), "--board chessboard --columns 6 --rows 4?")


def test_an_implausible_board_size_is_a_warning(recording: Path, tmp_path: Path) -> None:
    words = [*OPTIONS, "--square", "0.4", "--model", "radtan", "-o", tmp_path / "c.yaml"]
    result = run(recording, *words)
    assert result.exit_code == 0
    assert "the board would be 2.4 m wide" in result.stdout


def test_a_missing_output_folder_is_reported_before_the_work(
    recording: Path, tmp_path: Path
) -> None:
    result = run(recording, *OPTIONS, "-o", tmp_path / "missing" / "c.yaml")
    assert_one_line(result, "give a file in an existing folder")


def test_another_dictionary_is_suggested(recording: Path) -> None:
    words = run(recording, *OPTIONS, "--dictionary", "5X5_50")
    assert_one_line(words, "--dictionary 4X4")


def test_one_view_is_too_few(recording: Path) -> None:
    assert_one_line(run(recording, *OPTIONS, "--start", "1", "--end", "2"), "seen in 1 of 1 images")


def test_millimetres_are_refused(recording: Path) -> None:
    assert_one_line(run(recording, *OPTIONS, "--square", "40"), "--square is in metres")


def test_images_without_a_board(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((240, 320), 90, np.uint8))
    assert_one_line(run(tmp_path), "no chessboard of 9 x 6 inner corners")


def test_a_partly_visible_chessboard_is_not_detected(tmp_path: Path) -> None:
    board = make_board("chessboard", 5, 4, 0.04)
    for number, pose in enumerate(poses_around(board, CAMERA, 3)):
        image = render(board, CAMERA, pose)
        middle = pose @ np.array([0.12, 0.1, 0.0, 1.0])
        image[:, int(CAMERA.fx * middle[0] / middle[2] + CAMERA.cx) :] = 90
        cv2.imwrite(str(tmp_path / f"{number}.png"), image)
    assert_one_line(run(tmp_path, "--columns", "5", "--rows", "4"), "no chessboard of 5 x 4")


def test_left_and_right_images_of_different_sizes_are_refused(tmp_path: Path) -> None:
    for side, size in (("left", (240, 320)), ("right", (120, 160))):
        (tmp_path / side).mkdir()
        cv2.imwrite(str(tmp_path / side / "0.png"), np.full(size, 90, np.uint8))
    assert_one_line(run(tmp_path), "left images are 320x240, right ones")


def test_a_printed_board_is_detected(tmp_path: Path) -> None:
    from vo.tools.calibrating.detection import detect

    path = tmp_path / "board.png"
    assert run("--print-board", path, *OPTIONS).exit_code == 0
    assert str(vo.print_board(tmp_path / "same.png", **WORDS)) == str(BOARD)
    assert (tmp_path / "same.png").read_bytes() == path.read_bytes()
    page = cv2.resize(
        cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), None, fx=0.2, fy=0.2, interpolation=3
    )
    found = detect(BOARD, page)
    assert found is not None and len(found.ids) == 20
    spacing_m = (found.xy[1, 0] - found.xy[0, 0]) / 0.2 / 300 * 0.0254
    assert spacing_m == pytest.approx(BOARD.square_m, rel=0.002)
