"""Ctrl-C at any time: during start-up, during a command, and at exit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vo.cli.app import app

VO = Path(sys.executable).with_name("vo")

# Loaded by Python at start-up: sends SIGINT at the first import of a module, or at exit.
INTERRUPT_AT_IMPORT = """
import os, signal, sys

class Interrupter:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupter())
"""
INTERRUPT_AT_EXIT = (
    "import atexit, os, signal\natexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
)


def vo(folder: Path, start: str, *words: str | Path) -> subprocess.CompletedProcess[str]:
    (folder / "sitecustomize.py").write_text(start, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [VO, *words]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("name", ["vo.cli.app", "typer", "vo.cli.synth"])
def test_ctrl_c_during_start_up_prints_no_traceback(tmp_path: Path, name: str) -> None:
    result = vo(tmp_path, INTERRUPT_AT_IMPORT.format(name=name), "--help")
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "")


@pytest.mark.parametrize(
    "name", ["numpy", "cv2", "vo.runs.run_recording", "vo.engine.backend.optimizer"]
)
def test_ctrl_c_while_a_run_is_loaded_prints_one_line(tmp_path: Path, name: str) -> None:
    result = vo(
        tmp_path, INTERRUPT_AT_IMPORT.format(name=name), "run", tmp_path, "-o", tmp_path / "out"
    )
    assert result.returncode == 130
    assert result.stderr == "interrupted before the first frame; nothing was written\n"


@pytest.mark.parametrize("command", ["info", "eval", "report", "convert"])
def test_ctrl_c_while_another_command_is_loaded_prints_at_most_one_line(
    tmp_path: Path, command: str
) -> None:
    second = [tmp_path / "out"] if command in ("eval", "convert") else []
    result = vo(tmp_path, INTERRUPT_AT_IMPORT.format(name="numpy"), command, tmp_path, *second)
    assert result.returncode == 130, result.stderr
    assert len(result.stderr.splitlines()) <= 1


def test_ctrl_c_at_exit_is_ignored(tmp_path: Path) -> None:
    result = vo(tmp_path, INTERRUPT_AT_EXIT, "--version")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith("vo ")


COMMANDS = [str(command.name) for command in app.registered_commands]
ALL_HELP = """
import sys
from vo.cli.app import app
sys.argv[0] = "vo"
for command in sys.argv[1:]:
    app([command, "--help"], standalone_mode=False)
    print(chr(0))
"""


@pytest.fixture(scope="module")
def helps() -> dict[str, str]:
    """Of each command, from one process that has prepared all of them."""
    words = [sys.executable, "-c", ALL_HELP, *COMMANDS]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    return dict(zip(COMMANDS, done.stdout.split("\0\n"), strict=False))


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_the_same_with_only_one_command_prepared(
    tmp_path: Path, helps: dict[str, str], command: str
) -> None:
    alone = vo(tmp_path, "", command, "--help")
    assert alone.returncode == 0
    assert alone.stdout == helps[command]
