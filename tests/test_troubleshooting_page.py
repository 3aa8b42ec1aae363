"""The page docs/troubleshooting.md: it quotes messages that exist, and every fault is on it."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

from vo.base.faults import FaultKind

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "troubleshooting.md"
NOT_OURS = {"libGL.so.1: cannot open shared object file"}


@cache
def messages() -> str:
    """All texts in the code, with a NUL where a value is inserted, one a line."""
    found = []
    for path in (ROOT / "vo").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(re.sub(r"\{[^{}]*\}", "\0", node.value))
            elif isinstance(node, ast.JoinedStr):
                parts = (v.value if isinstance(v, ast.Constant) else "\0" for v in node.values)
                found.append("".join(map(str, parts)))
    return "\n".join(" ".join(text.split()) for text in found)


def first_cells() -> list[str]:
    """The first cell of each row of a table."""
    lines = PAGE.read_text("utf-8").splitlines()
    rows = [line for line in lines if line.startswith("| ") and not line.startswith("| ---")]
    return [re.split(r"(?<!\\) \| ", row.removeprefix("| "))[0] for row in rows]


def test_quoted_messages_exist() -> None:
    quoted = {text for cell in first_cells() for text in re.findall(r"`([^`]+)`", cell)} - NOT_OURS
    assert len(quoted) > 40
    unknown = []
    for text in quoted:
        pieces = [piece.strip() for piece in re.split(r"…|'\w+'", text) if piece.strip(" ;,:")]
        pattern = r"[^\n]*".join(re.escape(piece) for piece in pieces)
        if not re.search(pattern, messages()):
            unknown.append(text)
    assert unknown == []


def test_every_fault_is_explained() -> None:
    cells = " ".join(first_cells())
    assert [kind.value for kind in FaultKind if f"`{kind.value}`" not in cells] == []
