"""Long work is never silent where no terminal shows a bar."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys, vo.cli.heartbeat as heartbeat
heartbeat._EVERY_S = 0.05
sys.argv = ["vo", *sys.argv[1:]]
from vo.cli.entry import main
main()
"""


def vo(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


def test_rendering_is_told_with_its_frames(tmp_path: Path) -> None:
    words = ["--set", "scale=0.25", "--seconds", "3", "--mono"]
    result = vo(tmp_path, "synth", "walk", *words, "--json")
    assert result.returncode == 0
    lines = [line for line in result.stderr.splitlines() if line.startswith("synth: ")]
    assert any(re.fullmatch(r"synth: rendering \d+/60, \d+ s", line) for line in lines)
    result = vo(tmp_path, "synth", "other", *words, "--quiet")
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["markers", "{}", "--length", "0.1"], r"markers: .+"),
        (
            ["features", "{}", "--compare", "sift,orb", "--gaps", "1"],
            r"features: .* \d+/\d+, .+",
        ),
        (
            ["calibrate", "{}", "--board", "charuco", "--square", "0.02"],
            r"calibrate: searching for the board.*, \d+ s",
        ),
    ],
    ids=["markers", "features", "calibrate"],
)
def test_searching_is_told(
    synthetic_stereo: Path, tmp_path: Path, words: list[str], line: str
) -> None:
    result = vo(tmp_path, *(word.format(synthetic_stereo) for word in words))
    assert re.search(f"^{line}$", result.stderr, re.MULTILINE), result.stderr
