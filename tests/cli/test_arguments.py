"""Empty arguments, and the help text of every command."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from vo.cli.app import app

CHOICES = (
    "mode",
    "dataset",
    "rrd_images",
    "align",
    "board",
    "model",
    "matcher",
    "method",
    "refinement",
)  # Typer lists the choices
METAVAR = r"(-\|)?[A-Z][A-Z.=:,…|xN -]*"


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["run", "RECORDING", "-o", ""], "the value of -o"),
        (["run", "RECORDING", "--output", " "], "the value of --output"),
        (["run", "RECORDING", "--output="], "the value of --output"),
        (["run", "", "-o", "out"], "an argument"),
        (["run", "RECORDING", "-o", "out", "--rrd", ""], "the value of --rrd"),
        (["run", "RECORDING", "-o", "out", "--calibration", ""], "the value of --calibration"),
        (["convert", "RECORDING", ""], "an argument"),
        (["eval", "", "RECORDING"], "an argument"),
        (["report", ""], "an argument"),
        (["view", ""], "an argument"),
        (["synth", ""], "an argument"),
        (["demo", "--output", ""], "the value of --output"),
        (["info", "RECORDING", "--picture", ""], "the value of --picture"),
    ],
)
def test_an_empty_argument_is_refused(
    words: list[str], what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert result.stderr == f"error: {what} is empty; is a shell variable not set?\n"
    assert not list(tmp_path.iterdir())


def test_an_empty_value_of_a_setting_is_checked_by_the_settings(tmp_path: Path) -> None:
    words = ["run", str(tmp_path), "-o", str(tmp_path / "out"), "--set", "features.count="]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert "features.count" in result.stderr


COMMANDS = get_command(app).commands  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_argument_has_help_and_a_metavar(name: str) -> None:
    command = COMMANDS[name]
    for parameter in command.params:
        assert parameter.help.endswith("."), parameter.name
        choice_or_flag = getattr(parameter, "is_flag", False) or parameter.name in CHOICES
        if not choice_or_flag:
            assert re.fullmatch(METAVAR, parameter.metavar or ""), parameter.name


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_begins_with_one_sentence_and_contains_an_example(name: str) -> None:
    command = COMMANDS[name]
    first, _, rest = command.help.partition("\n\n")
    assert first.endswith(".") and first.count(". ") == 0
    assert f"  vo {name}" in rest


@pytest.mark.parametrize("name", ["run", "info", "convert", "calibrate", "eval", "synth"])
def test_options_are_grouped(name: str) -> None:
    command = COMMANDS[name]
    ungrouped = {
        parameter.name
        for parameter in command.params
        if parameter.param_type_name == "option" and parameter.rich_help_panel is None
    }
    assert ungrouped <= {"list_", "help_all"}
