"""The commands as functions, and a user's program under strict type checking."""

from __future__ import annotations

import inspect
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import typer

import vo

ROOT = Path(__file__).resolve().parents[2]


# Options that have another name in Python, mostly one with its unit.
RENAMED = {"topic": "topics", "right_offset": "right_offset_ns", "set": "overrides"} | {
    "timeout": "timeout_s",
    "duration": "duration_s",
    "memory": "memory_mb",
    "all": "all_images",
    "no_imu": "imu",
    "connect": "viewer",
    "allow_host": "allow_hosts",
    "allow_origin": "allow_origins",
    "delta": "delta_frames",
    "tolerance": "tolerance_s",
    "interpolate": "interpolated",
    "threshold": "threshold_px",
    "rig": "camera",
}
# What only makes sense in a terminal: printing, exit status, windows, lists of choices.
OF_TERMINALS = {"help", "help_all", "json", "quiet", "verbose", "fail_under", "list", "profile"} | {
    "keypoints",
    "spawn",
    "serve",
}
COMMANDS: dict[str, tuple[Callable[..., Any], ...]] = {
    "run": (vo.run,),
    "eval": (vo.evaluate,),
    "info": (vo.info,),
    "convert": (vo.convert,),
    "synth": (vo.synth,),
    "report": (vo.report,),
    "video": (vo.video,),
    "batch": (vo.batch,),
    "calibrate": (vo.calibrate, vo.calibrate_imu),
    "match": (vo.match, vo.match_folder),
}
# These choose another function.
FUNCTIONS = {"dense": "dense", "imu_noise": "calibrate_imu_noise", "print_board": "print_board"}


def words_of(function: Callable[..., Any]) -> set[str]:
    """Names of all arguments of a function, also of those by keyword."""
    hints, words = get_type_hints(function), set()
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            words |= set(get_type_hints(get_args(hints[name])[0]))
        else:
            words.add(name)
    return words


@pytest.mark.parametrize("name", COMMANDS)
def test_all_that_a_command_does_is_a_word_of_its_function(name: str) -> None:
    from vo.cli.app import app

    command: Any = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    options = [word for each in command.params for word in each.opts if word.startswith("--")]
    words = set().union(*map(words_of, COMMANDS[name])) | {"imu"}
    missing = []
    for option in (each[2:].replace("-", "_") for each in options):
        known = option in OF_TERMINALS or RENAMED.get(option, option) in words
        if not known and not callable(getattr(vo, FUNCTIONS.get(option, "?"), None)):
            missing.append(option)
    assert missing == []


def test_a_recording_is_made_inspected_converted_run_and_reported(tmp_path: Path) -> None:
    words = {"seconds": 2.0, "mono": True, "camera": "pinhole"}
    walk = vo.synth(tmp_path / "walk", overrides=["scale=0.25"], **words)  # type: ignore[arg-type]
    found = vo.info(walk)
    assert (found.format, len(found.cameras), found.pair) == ("euroc", 1, None)
    short = vo.convert(walk, tmp_path / "short", end=20, to="kitti")
    assert len(vo.open(short)) == 20  # type: ignore[arg-type]
    vo.run(short, tmp_path / "out", "fast")
    pytest.importorskip("matplotlib")
    page = vo.report(tmp_path / "out", images=False)
    assert page == tmp_path / "out" / "report.html" and page.stat().st_size > 10_000
    film = vo.video(tmp_path / "out", output=tmp_path / "run.mp4", end=12, width=640)
    assert film.images == 12 and film.output.stat().st_size > 10_000


def test_a_batch_runs_all(synthetic_stereo: Path, tmp_path: Path) -> None:
    shutil.copytree(synthetic_stereo, tmp_path / "all" / "a")
    result = vo.batch(tmp_path / "all", tmp_path / "out", "fast", jobs=1)
    assert [each.name for each in result.results] == ["a"] and not result.unfinished


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: vo.convert(p, p / "x", too="kitti"), "unknown option 'too'; did you mean 'to'?"),
        (lambda p: vo.convert(p / "a", p / "x", resize="big"), "invalid `resize=big`"),
        (lambda p: vo.info(p, mod="mono"), "unknown option 'mod'; did you mean 'mode'?"),
        (lambda p: vo.synth(p / "x", second=3), "unknown option 'second'"),
        (lambda p: vo.calibrate(p, sqare=0.1), "unknown option 'sqare'; did you mean 'square'?"),
        (lambda p: vo.calibrate(p, columns=2), "2"),
        (lambda p: vo.batch(p, p / "o", jobs="2"), "the option jobs is '2', not a whole number"),
        (lambda p: vo.batch(p, p / "o", threads=2), "`threads` goes with `ray`"),
        (lambda p: vo.batch(p, p / "o", ray="auto", jobs=2), "Ray decides by cores"),
        (lambda p: vo.print_board(p / "b.png", colums=4), "did you mean 'columns'?"),
        (lambda p: vo.calibrate_imu(p, look_at=3), "unknown option 'look_at'"),
        (lambda p: vo.synth(p / "x", effects="blur"), "invalid effect 'blur'"),
    ],
)
def test_what_cannot_be_meant_is_refused(call, message: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(vo.ConfigError) as error:
        call(tmp_path)
    assert message in str(error.value)


def test_a_users_program_is_typed() -> None:
    pytest.importorskip("mypy")
    program = Path(__file__).with_name("user_program.py")
    words = ["--strict", "--config-file=", "--follow-imports=silent", "--warn-unused-ignores"]
    result = subprocess.run(
        [sys.executable, "-m", "mypy", *words, "--ignore-missing-imports", str(program)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout
