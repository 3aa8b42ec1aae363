"""What the command line says of words that nobody can have meant."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from vo.cli.app import app


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["run", "RECORDING", "-o", ""], "what follows -o"),
        (["run", "RECORDING", "--output", " "], "what follows --output"),
        (["run", "RECORDING", "--output="], "what follows --output"),
        (["run", "", "-o", "out"], "an argument"),
        (["run", "RECORDING", "-o", "out", "--rrd", ""], "what follows --rrd"),
        (["run", "RECORDING", "-o", "out", "--calibration", ""], "what follows --calibration"),
        (["convert", "RECORDING", ""], "an argument"),
        (["eval", "", "RECORDING"], "an argument"),
        (["report", ""], "an argument"),
        (["view", ""], "an argument"),
        (["synth", ""], "an argument"),
        (["demo", "--output", ""], "what follows --output"),
        (["info", "RECORDING", "--contact-sheet", ""], "what follows --contact-sheet"),
    ],
)
def test_an_empty_word_is_no_path(
    words: list[str], what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert result.stderr == f"error: {what} is empty; is a variable of the shell not set?\n"
    assert not list(tmp_path.iterdir())


def test_an_empty_value_of_a_setting_is_left_to_the_settings(tmp_path: Path) -> None:
    words = ["run", str(tmp_path), "-o", str(tmp_path / "out"), "--set", "features.count="]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert "features.count" in result.stderr
