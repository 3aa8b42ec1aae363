"""What the command line says of words that nobody can have meant."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from vo.cli.app import app

CHOICES = ("mode", "rrd_images", "align", "board", "model")  # typer lists what there is to choose
METAVAR = r"[A-Z][A-Z.=:,…|xN-]*"


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


COMMANDS = sorted(get_command(app).commands)  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_says_of_every_word_what_it_is(name: str) -> None:
    command = get_command(app).commands[name]  # type: ignore[attr-defined]
    for parameter in command.params:
        assert parameter.help.endswith("."), parameter.name
        choice_or_flag = getattr(parameter, "is_flag", False) or parameter.name in CHOICES
        if not choice_or_flag:
            assert re.fullmatch(METAVAR, parameter.metavar or ""), parameter.name
