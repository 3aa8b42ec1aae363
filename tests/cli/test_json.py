"""`--json` and `-q` of every command: JSON alone on standard output, or nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from vo.base.config import load_config
from vo.cli.app import app
from vo.runs.run_recording import run

SMALL = ("--seconds", "0.3", "--fps", "10", "--set", "scale=0.25", "--motion", "handheld")


def vo(*words: object) -> Result:
    result = CliRunner().invoke(app, list(map(str, words)), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result


def json_of(*words: object) -> dict[str, Any]:
    printed = json.loads(vo(*words, "--json").stdout)
    assert isinstance(printed, dict)
    return printed


@pytest.fixture(scope="module")
def folder(synthetic_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a run on a few frames."""
    out = tmp_path_factory.mktemp("json") / "out"
    run(synthetic_stereo, out, config=load_config("fast"), end=8)
    return out


def test_convert(synthetic_stereo: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    printed = json_of("convert", synthetic_stereo, log, "--end", 1, "--codec", "jpeg")
    assert printed["inertial_samples"] >= 0 and printed["ground_truth_poses"] > 0
    del printed["inertial_samples"], printed["ground_truth_poses"]
    assert printed == {
        "output": str(log),
        "format": "mcap",
        "codec": "jpeg",
        "mode": "stereo",
        "cameras": 2,
        "frames": 1,
        "width": 400,
        "height": 250,
        "colour": False,
    }
    text = vo("convert", synthetic_stereo, tmp_path / "one", "--end", 1).stdout
    assert "1 stereo frame, 400x250 grey, euroc (png)" in text
    quiet = vo("convert", synthetic_stereo, tmp_path / "two", "--end", 1, "-q")
    assert quiet.stdout == ""


def test_synth(tmp_path: Path) -> None:
    printed = json_of("synth", tmp_path / "a", *SMALL, "--to", "folder")
    assert printed.pop("path_m") >= 0.0
    assert printed == {
        "output": str(tmp_path / "a"),
        "format": "folder",
        "mode": "stereo",
        "cameras": 2,
        "frames": 3,
        "seconds": 0.3,
    }
    assert vo("synth", tmp_path / "b", *SMALL, "-q").stdout == ""
    choices = json_of("synth", "--list")
    assert "kitti" in choices["presets"] and "kitti" in choices["cameras"]
    assert choices["settings"]["format"] == "euroc"


def test_eval(folder: Path, synthetic_stereo: Path) -> None:
    picture = folder / "errors.png"
    printed = json_of("eval", folder, synthetic_stereo, "--picture", picture)
    assert printed["picture"] == printed["plot"] == str(picture)
    assert vo("eval", folder, synthetic_stereo, "-q").stdout == ""


def test_info(synthetic_stereo: Path, tmp_path: Path) -> None:
    printed = json_of("info", synthetic_stereo, "--picture", tmp_path / "sheet.png")
    assert printed["picture"] == str(tmp_path / "sheet.png")
    assert printed["format"] == "euroc"
    quiet = vo("info", synthetic_stereo, "-q")
    assert (quiet.stdout, quiet.stderr) == ("", "")


def test_a_quiet_info_prints_problems_on_standard_error(images: Path) -> None:
    (images / "calibration.yaml").write_text("cam0: 3\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["info", str(images), "-q"])
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr.startswith("problem: ")
    assert "calibration.yaml" in result.stderr


def test_a_verbose_info_tells_what_is_read(images: Path) -> None:
    result = CliRunner().invoke(app, ["info", str(images), "-v", "--json"])
    assert json.loads(result.stdout)["format"] == "folder"
    assert f"{images / 'calibration.yaml'}: calibration of format vo" in result.stderr


def test_warmup() -> None:
    printed = json_of("warmup")
    assert set(printed) == {"compiled", "seconds", "folder"}
    assert vo("warmup", "-q").stdout == ""


def test_a_board_to_print(tmp_path: Path) -> None:
    board = tmp_path / "board.svg"
    printed = json_of("calibrate", "--print-board", board)
    assert printed["output"] == str(board)
    assert printed["board"].startswith("chessboard")


def test_view_prints_its_address_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    from vo.cli.options import Printing
    from vo.cli.view import print_address

    address = Path("run.rrd"), "http://localhost:1?url=x", 2
    print_address(Printing(json_output=True), *address)
    assert json.loads(capsys.readouterr().out) == {
        "recording": "run.rrd",
        "address": "http://localhost:1?url=x",
        "data_port": 2,
    }
    print_address(Printing(quiet=True), *address)
    assert capsys.readouterr().out == ""


def test_poses_and_json_are_not_both_on_standard_output(images: Path, tmp_path: Path) -> None:
    words = ["run", str(images), "-o", str(tmp_path / "out"), "--json", "--poses", "-"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "both need standard output" in " ".join(result.stderr.split())
