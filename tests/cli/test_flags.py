"""Messages of the library name options as Python has them; the command line translates them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

import vo
from vo.base.errors import VoError
from vo.cli.app import app
from vo.cli.blocks import CommandFunction
from vo.cli.calibrate import calibrate_command
from vo.cli.flags import in_flags, speak_as
from vo.cli.run import run_command

ROOT = Path(vo.__file__).resolve().parent
_FLAG = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
_COMMAND = re.compile(r"`?\b(vo|ray|evo_rpe) [a-z]+[^`]*$|`[a-z-]+ [^`]*$")


def _messages(path: Path) -> Iterator[str]:
    """Texts with spaces that are no docstrings; values in them are written as x."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            alone.update(id(part) for part in node.values)
            parts = (part.value if isinstance(part, ast.Constant) else "x" for part in node.values)
            yield "".join(map(str, parts))
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone
        ):
            yield node.value


def test_messages_outside_the_command_line_have_no_flags() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {text}"
        for path in sorted(ROOT.rglob("*.py"))
        if path.parent.name != "cli" and path.name != "printing.py"  # a command, on a board
        for text in _messages(path)
        if " " in text.strip() and not text.startswith(" --")  # words of a command
        if any(not _COMMAND.search(text[: flag.start()]) for flag in _FLAG.finditer(text))
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("use `mode=mono`", "use --mode mono"),
        ("leave out `memory.loops=false`", "leave out --no-loops"),
        ("shift by `right_offset_ns`, `masks.files`", "shift by --right-offset, --mask"),
        ("`columns=9` and `square_m`", "--columns 9 and --square"),
        ("`features.detector=orb`", "--set features.detector=orb"),
        ("again with `inertial.enabled=false`", "again with --no-imu"),
    ],
)
def test_a_command_speaks_of_its_flags_and_those_of_run(text: str, printed: str) -> None:
    speak_as(CommandFunction(run_command))
    speak_as(CommandFunction(calibrate_command))
    assert in_flags({"texts": [text]}) == {"texts": [printed]}


def test_an_error_names_the_option_in_python_and_the_flag_in_the_command_line(
    tmp_path: Path,
) -> None:
    (tmp_path / "images").mkdir()
    with pytest.raises(VoError) as caught:
        vo.run(tmp_path / "images", tmp_path / "out", overrides=["memory.localize=true"])
    assert (
        str(caught.value) == "`memory.localize` finds poses in a map; give it by `memory.map=FILE`"
    )
    words = ["run", str(tmp_path / "images"), "-o", str(tmp_path / "out"), "--localize"]
    result = CliRunner().invoke(app, words)
    assert result.stderr == "error: --localize finds poses in a map; give it by --map FILE\n"
