"""What a run starts: no process for windows, and one warning line for old names of settings."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

VO = Path(sys.executable).with_name("vo")

# Loaded by Python at start-up: records each process.
NOTE = """
import os
from pathlib import Path

(Path(__file__).parent / f"{os.getpid()}.pid").touch()
"""


def run(folder: Path, source: Path, *words: str) -> tuple[int, str]:
    """Exit status and standard error of a run."""
    (folder / "sitecustomize.py").write_text(NOTE, encoding="utf-8")
    command = [VO, "run", source, "-o", folder / "out", *words]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    return done.returncode, done.stderr


def processes(folder: Path) -> int:
    """Number of Python's processes that have been started."""
    return len(list(folder.glob("*.pid")))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_run_without_loops_is_one_process(
    threads: int, synthetic_stereo: Path, tmp_path: Path
) -> None:
    words = ("--set", f"threads={threads}", "--end", "4")
    before, counted = tmp_path / "before", tmp_path / "counted"
    for folder in (before, counted):  # the first may compile, in two processes
        folder.mkdir()
        assert run(folder, synthetic_stereo, *words)[0] == 0
    assert processes(counted) == 1


def test_an_old_name_of_a_setting_gets_one_warning_line(
    synthetic_stereo: Path, tmp_path: Path
) -> None:
    words = ("--set", "mapping.look_back=3", "--end", "2", "--quiet")
    status, errors = run(tmp_path, synthetic_stereo, *words)
    renamed = "mapping.look_back is now mapping.fuse_keyframes"
    assert (status, errors) == (0, f"warning: settings in default have been renamed: {renamed}\n")
