"""Values of options are those that Typer reads, mostly without pydantic, which takes 60 ms."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer.main

from vo.cli import command
from vo.cli.app import app


def _parsed(arguments: list[str]) -> dict[str, Any] | str:
    group: Any = typer.main.get_command(app)
    run = group.commands["run"]
    try:
        given: dict[str, Any] = run.make_context("run", list(arguments)).params
    except typer.BadParameter as error:
        return error.format_message()
    return given


@pytest.mark.parametrize(
    "words",
    [
        "",
        "--end 2 --start 0 --stride 3 --threads 1 --mode mono --config fast --quiet",
        "--set a.b=1 --set seed=2 --mask left.png --calibration camera.yaml --rrd-images full",
        "--end 0x2",
        "--end -1",
        "--end 2.0",
        "--end 12345678901234567890",
        "--stride 0",
        "--mode sideways",
        "--timeout 1e1 --right-offset -2.5 --lever-arm 1 2 3",
        "--timeout soon",
        "--no-loops --profile",
    ],
)
def test_values_and_messages_are_those_of_typer(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["recording", "-o", str(tmp_path), *words.split()]
    ours = _parsed(arguments)
    monkeypatch.setattr(command, "read_plainly", lambda parameters: parameters)
    theirs = _parsed(arguments)
    assert ours == theirs
    if isinstance(ours, dict) and isinstance(theirs, dict):
        assert [type(value) for value in ours.values()] == [type(v) for v in theirs.values()]


def test_a_quiet_run_loads_neither_pydantic_nor_rich(tmp_path: Path) -> None:
    program = (
        "import sys, atexit; from vo.cli.entry import main; atexit.register(lambda: print("
        "sorted({'pydantic', 'rich', 'yaml'} & set(sys.modules))));"
        "sys.argv[0] = 'vo'; main()"
    )
    arguments = ["run", str(tmp_path), "--end", "2", "-o", str(tmp_path / "out"), "--quiet"]
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and "error:" in done.stderr
    assert done.stdout == "[]\n"
