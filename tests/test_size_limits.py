"""Sizes of files, functions and parameter lists, so that the code stays readable."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_PARAMETERS = 8
MAX_COMMAND_PARAMETERS = 12  # blocks of options count once
MAX_ODOMETRY_LINES = 250

Function = ast.FunctionDef | ast.AsyncFunctionDef


def is_kernel(function: Function) -> bool:
    """Whether a function is compiled, where loops are long and records are not always possible."""
    return any(
        "compiled" in ast.unparse(d) or "kernel" in ast.unparse(d) for d in function.decorator_list
    )


def is_command(path: Path, function: Function) -> bool:
    """Whether the parameters are options of a command."""
    return path.parent.name == "cli" and function.name.endswith("_command")


def violations(path: Path, text: str) -> Iterator[str]:
    """One line for each broken limit of a file."""
    lines = len(text.splitlines())
    if lines > MAX_FILE_LINES:
        yield f"{path} has {lines} lines"
    if "kernels" in path.parts:
        return
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, Function) or is_kernel(node):
            continue
        assert node.end_lineno is not None
        length = node.end_lineno - node.lineno + 1
        if length > MAX_FUNCTION_LINES and not is_command(path, node):
            yield f"{path}:{node.lineno}: {node.name} has {length} lines"
        arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        count = sum(a.arg not in ("self", "cls") for a in arguments)
        limit = MAX_COMMAND_PARAMETERS if is_command(path, node) else MAX_PARAMETERS
        if count > limit:
            yield f"{path}:{node.lineno}: {node.name} has {count} parameters"


def test_project_keeps_the_size_limits() -> None:
    files = [p for package in ("vo", "data_synth") for p in sorted((ROOT / package).rglob("*.py"))]
    assert len(files) > 100
    found = [
        line
        for path in files
        for line in violations(path.relative_to(ROOT), path.read_text(encoding="utf-8"))
    ]
    assert found == []


def test_the_odometry_can_be_read_at_once() -> None:
    lines = (ROOT / "vo" / "engine" / "odometry.py").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_ODOMETRY_LINES


@pytest.mark.parametrize(
    ("code", "complaint"),
    [
        ("x = 1\n" * 401, "401 lines"),
        ("def f():\n" + "    x = 1\n" * 60, "f has 61 lines"),
        ("def f(a, b, c, d, e, *, f, g, h, i):\n    pass", "f has 9 parameters"),
    ],
)
def test_a_broken_limit_is_found(code: str, complaint: str) -> None:
    (line,) = violations(Path("vo/thing.py"), code)
    assert complaint in line


@pytest.mark.parametrize(
    "code",
    [
        "@compiled\ndef f(a, b, c, d, e, f, g, h, i):\n" + "    x = 1\n" * 80,
        "class A:\n    def f(self, a, b, c, d, e, f, g, h):\n        pass",
    ],
)
def test_kernels_and_methods_within_the_limits_pass(code: str) -> None:
    assert list(violations(Path("vo/thing.py"), code)) == []
