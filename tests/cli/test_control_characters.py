"""Names in a recording and of files cannot write control characters to the terminal or a page."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sqlite3
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vo.base.printable import printable
from vo.cli.app import app
from vo.cli.console import SafeConsole, standard_error, standard_output
from vo.cli.echo import echo_error

_ATTACK = "\x1b]0;owned\x07\x1b[2J\x9b31m\r\u202e\x7f"
_FORBIDDEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


def run(*words: object, folder: Path) -> tuple[int, str]:
    with contextlib.chdir(folder):
        done = CliRunner().invoke(app, list(map(str, words)), catch_exceptions=False)
    return done.exit_code, done.stdout + done.stderr


def recording(folder: Path, grey: int = 3) -> Path:
    folder.mkdir()
    (folder / "calibration.yaml").write_text(
        "cam0: {resolution: [64, 48], intrinsics: [60, 60, 32, 24]}\n", encoding="utf-8"
    )
    for number in range(grey):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((48, 64), number, np.uint8))
    return folder


def log_with_topic(path: Path, name: str) -> Path:
    """A ROS 2 bag with a topic of that name."""
    database = sqlite3.connect(path)
    database.executescript(
        "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB);"
        "INSERT INTO messages VALUES (1, 1, 1, x'00');"
    )
    database.execute("INSERT INTO topics VALUES (1, ?, ?, 'cdr')", (name, "sensor_msgs/msg/Image"))
    database.commit()
    database.close()
    return path


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Bär, 日本, 👩\tend\n", "Bär, 日本, 👩\tend\n"),
        ("\x1b[31m", "\\x1b[31m"),
        ("a\rb\x00\x7f\x9b", "a\\x0db\\x00\\x7f\\x9b"),
        ("abc\u202edef", "abc\\u202edef"),
    ],
)
def test_printable(text: str, expected: str) -> None:
    assert printable(text) == expected


def test_a_console_keeps_its_own_codes() -> None:
    file = io.StringIO()
    console = SafeConsole(file=file, force_terminal=True, color_system="standard", highlight=False)
    console.print("[bold]name[/]", _ATTACK, markup=True)
    assert "\x1b[1m" in file.getvalue()
    assert "\\x1b]0;owned" in file.getvalue()
    assert "\x1b]" not in file.getvalue() and "\x1b[2J" not in file.getvalue()


@pytest.mark.parametrize("command", [("info",), ("run", "-o", "out"), ("info", "--json")])
def test_topics(command: tuple[str, ...], tmp_path: Path) -> None:
    log = log_with_topic(tmp_path / "a.db3", _ATTACK)
    status, text = run(command[0], log, *command[1:], folder=tmp_path)
    assert status == 1
    assert not _FORBIDDEN.search(text)
    if "--json" not in command:
        assert "\\x1b]0;owned" in text


def test_names_of_files(tmp_path: Path) -> None:
    folder = recording(tmp_path / _ATTACK.replace("\x9b", ""))
    for words in (
        ("info", folder.name),
        ("run", folder.name, "-o", "out\x1b[2J"),
        ("report", "out\x1b[2J"),
        ("eval", "a\x1b[2J.tum", "b"),
        ("convert", folder.name, "converted\x1b[2J"),
        ("view", "a\x1b[2J.rrd"),
        ("calibrate", folder.name),
    ):
        _, text = run(*words, folder=tmp_path)
        assert text and not _FORBIDDEN.search(text), words


def test_markup_in_names(tmp_path: Path) -> None:
    folder = recording(tmp_path / "[bold]$x_")
    trajectory = tmp_path / "[red]$_.tum"
    trajectory.write_text(
        "".join(f"{k} {k * k} {k} 0 0 0 0 1\n" for k in range(20)), encoding="utf-8"
    )
    status, text = run(
        "eval", trajectory.name, trajectory.name, "--picture", "p.png", folder=tmp_path
    )
    assert status == 0 and "[red]$_.tum" in text
    assert "[bold]$x_" in run("info", folder.name, folder=tmp_path)[1]


def test_the_report(tmp_path: Path) -> None:
    folder = recording(tmp_path / "folder")
    run("run", folder, "-o", "out", folder=tmp_path)
    summary = tmp_path / "out" / "summary.json"
    changed = json.loads(summary.read_text("utf-8"))
    changed["source"], changed["warnings"] = f"<script>{_ATTACK}", [f"<b>{_ATTACK}"]
    summary.write_text(json.dumps(changed), encoding="utf-8")
    status, text = run("report", "out", folder=tmp_path)
    assert status == 0 and not _FORBIDDEN.search(text)
    (file,) = tmp_path.rglob("*.html")
    page = file.read_text("utf-8")
    assert not _FORBIDDEN.search(page)
    assert f"<script>{chr(92)}x1b" not in page


def test_json_is_still_json(tmp_path: Path) -> None:
    folder = recording(tmp_path / "a\x7fb\x9bc")
    _, text = run("info", folder.name, "--json", folder=tmp_path)
    assert not _FORBIDDEN.search(text)
    assert "a\x7fb\x9bc" in json.loads(text)["path"]


@pytest.mark.parametrize("folder", [Path("vo/cli"), Path("vo")])
def test_everything_is_printed_in_one_place(folder: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    direct = re.compile(r"typer\.echo\(|click\.echo\(|(?<![\w.])print\(|(?<!Safe)Console\(")
    for file in sorted((root / folder).rglob("*.py")):
        if file.name not in ("echo.py", "console.py", "heartbeat.py"):  # all use `printable`
            assert not direct.search(file.read_text("utf-8")), file


def test_names_between_colons_stay(capsys: pytest.CaptureFixture[str]) -> None:
    for console in (standard_output(), standard_error()):
        console.print("`ffmpeg -map 0:v:0`, /tf:map:base_link")
    assert "".join(capsys.readouterr()) == "`ffmpeg -map 0:v:0`, /tf:map:base_link\n" * 2


@pytest.mark.parametrize("text", ["--no-loops \x1b\x9b31m", "[bold]café[/] :smile:", "x" * 300])
def test_a_quiet_run_prints_lines_as_a_console_does(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    standard_error().print(text, markup=False, highlight=False, soft_wrap=True)
    expected = capsys.readouterr().err
    echo_error(text)
    assert capsys.readouterr().err == expected
