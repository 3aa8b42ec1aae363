"""One grammar for all commands: short help, completion, and names of the release before."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from run_calls import VO
from typer.main import get_command
from typer.testing import CliRunner

from data_synth.writers.registry import FORMATS as WRITERS
from vo.cli.app import app
from vo.cli.command import with_new_names
from vo.cli.completion import CODECS, INPUT_FORMATS, OUTPUT_FORMATS
from vo.recordings.sources.registry import FORMATS as SOURCES

COMMANDS = {name: command for name, command in get_command(app).commands.items()}  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_h_prints_the_help(name: str) -> None:
    words = [name] if name else []
    short, long = (CliRunner().invoke(app, [*words, option]) for option in ("-h", "--help"))
    assert short.exit_code == 0
    assert short.stdout == long.stdout
    assert "Usage:" in short.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_few_options_and_points_to_the_rest(name: str) -> None:
    options = [p.opts[0] for p in COMMANDS[name].params if p.param_type_name == "option"]
    result = CliRunner().invoke(app, [name, "--help"], terminal_width=100)
    shown = re.findall(r"^│ [ *]{0,4}(--[a-z-]+)", result.stdout, re.MULTILINE)
    assert len(shown) <= 14
    assert ("--help-all" in options) == (len(options) > 14)
    if "--help-all" in options:
        assert len(shown) <= 10
        assert f"{len(options) - len(shown) + 1} more options" in result.stdout
        everything = CliRunner().invoke(app, [name, "--help-all"], terminal_width=100)
        assert everything.exit_code == 0
        assert [option for option in options if option not in everything.stdout] == []


def test_help_of_the_program_begins_with_three_commands() -> None:
    text = CliRunner().invoke(app, ["--help"]).stdout
    panels = re.findall(r"╭─ (.*?) ─+╮\n(.*?)╰", text, re.DOTALL)
    rows = {name: re.findall(r"^│ ([a-z]+) ", body, re.MULTILINE) for name, body in panels[1:]}
    assert list(rows)[0] == "Start here" and len(rows) == 4
    assert rows["Start here"] == ["demo", "info", "run"]
    assert sorted(sum(rows.values(), [])) == sorted(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_can_be_verbose_quiet_or_print_json(name: str) -> None:
    options = {word for parameter in COMMANDS[name].params for word in parameter.opts}
    assert {"--json", "--quiet", "-q", "--verbose", "-v"} <= options


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_is_not_quiet_and_verbose(name: str) -> None:
    required = [p for p in COMMANDS[name].params if p.required and p.param_type_name == "argument"]
    first = {"memory": "show", "map": "info", "vocabulary": "train", "recognize": "list"}.get(
        name, "x"
    )
    words = [name, *([first, *"x" * len(required)][: len(required)]), "-q", "-v"]
    words += ["-o", "y"] if name in ("run", "vocabulary", "panorama") else []
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "use only one of --quiet and --verbose" in " ".join(result.stderr.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_formats_and_pictures_are_called_the_same(name: str) -> None:
    options = {p.name: p for p in COMMANDS[name].params}
    reads_a_recording = name in (
        *("run", "batch", "info", "convert", "calibrate", "features"),
        *("markers", "recognize"),
    )
    writes_a_recording = name in ("convert", "synth")
    assert ("format" in options) == reads_a_recording
    assert ("to" in options) == writes_a_recording
    with_picture = (
        "eval",
        "info",
        "report",
        "calibrate",
        "features",
        "match",
        "memory",
        "markers",
        "recognize",
    )
    assert ("picture" in options) == (name in with_picture)


def test_the_package_runs_as_a_module(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "vo"]
    for arguments in (["--version"], ["info", "none"]):
        module = subprocess.run([*words, *arguments], cwd=tmp_path, capture_output=True, text=True)
        program = subprocess.run([VO, *arguments], cwd=tmp_path, capture_output=True, text=True)
        assert (module.returncode, module.stdout) == (program.returncode, program.stdout)
        assert module.stderr == program.stderr


@pytest.mark.parametrize(
    ("command", "given", "new", "note"),
    [
        ("eval", ["a", "b", "--plot", "p.png"], ["a", "b", "--picture", "p.png"], "--plot"),
        ("eval", ["--plot=p.png"], ["--picture=p.png"], "--plot"),
        ("info", ["--contact-sheet", "s.png"], ["--picture", "s.png"], "--contact-sheet"),
        ("report", ["out", "--plots", "figs"], ["out", "--picture", "figs"], "--plots"),
        ("synth", ["a", "--format", "tum"], ["a", "--to", "tum"], "--format"),
        ("convert", ["--source-format=euroc"], ["--format=euroc"], "--source-format"),
        ("convert", ["a", "b", "--format", "kitti"], ["a", "b", "--to", "kitti"], "--to kitti"),
        ("convert", ["--format=mcap-ros2"], ["--to=mcap-ros2"], "--to mcap-ros2"),
    ],
)
def test_old_names_are_understood_with_a_note(
    command: str,
    given: list[str],
    new: list[str],
    note: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert with_new_names(command, given) == new
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("note: ") and printed.err.count("\n") == 1
    assert note in printed.err


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("convert", ["a", "b", "--format", "kitti", "--to", "euroc"]),
        ("convert", ["a", "b", "--format", "kitti_raw"]),  # not a format to write
        ("convert", ["a", "b", "--", "--source-format"]),
        ("run", ["a", "--format", "euroc"]),
        ("info", ["a", "--picture", "b.png"]),
    ],
)
def test_new_names_are_left_alone(
    command: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert with_new_names(command, words) == words
    assert capsys.readouterr().err == ""


def test_old_names_are_in_no_help() -> None:
    options = {(name, word) for name, c in COMMANDS.items() for p in c.params for word in p.opts}
    old = {("eval", "--plot"), ("info", "--contact-sheet"), ("report", "--plots")}
    old |= {("convert", "--source-format"), ("synth", "--format")}
    assert not options & old


def completed(tmp_path: Path, *words: str) -> list[str]:
    """Completions of the last word in bash."""
    environment = {
        **os.environ,
        "_VO_COMPLETE": "complete_bash",
        "COMP_WORDS": "\n".join(["vo", *words]),
        "COMP_CWORD": str(len(words)),
    }
    done = subprocess.run([VO], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["dem"], ["demo"]),
        (["run", "--fo"], ["--format", "--follow"]),
        (["run", "--mode", ""], ["auto", "mono", "stereo"]),
        (["run", "x", "--config", ""], ["accurate", "best", "default", "fast"]),
        (["convert", "x", "y", "--to", "m"], ["mcap", "mcap-ros2"]),
        (["info", "x", "--format", "kitti"], ["kitti", "kitti_raw"]),
        (["features", "x", "--detector", "k"], ["kaze"]),
        (["features", "x", "--descriptor", "root"], ["rootsift"]),
        (["synth", "--preset", "ki"], ["kitti"]),
        (["synth", "x", "--camera", "ki"], ["kitti"]),
        (["run", "x.mcap", "--topic", ""], []),  # there is no such file
    ],
)
def test_the_shell_completes(words: list[str], found: list[str], tmp_path: Path) -> None:
    assert sorted(completed(tmp_path, *words)) == sorted(found)


def test_the_shell_completes_topics_of_a_log(images: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    assert CliRunner().invoke(app, ["convert", str(images), str(log)]).exit_code == 0
    assert completed(tmp_path, "run", "log.mcap", "--topic", "") == ["/cam0/image_raw/compressed"]


def test_completed_values_are_those_that_exist() -> None:
    assert set(INPUT_FORMATS) == set(SOURCES)
    assert set(OUTPUT_FORMATS) == set(WRITERS)
    assert set(CODECS) == {codec for writer in WRITERS.values() for codec in writer.codecs}
