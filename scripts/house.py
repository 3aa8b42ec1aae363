"""Counts the lines of the code by wing, and the words of the documentation.

Usage: scripts/house [--json]
"""

from __future__ import annotations

import argparse
import ast
import json
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
KINDS = ("code", "docstring", "comment", "blank")


def line_kinds(path: Path) -> Counter[str]:
    """Number of lines of a module by kind; a comment behind code is code."""
    text = path.read_text(encoding="utf-8")
    lines = map(str.strip, text.splitlines())
    kinds = ["comment" if line[:1] == "#" else "code" if line else "blank" for line in lines]
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            docstrings.append(node.body[0])
        elif isinstance(node, ast.Constant | ast.JoinedStr) and node.end_lineno != node.lineno:
            _mark(kinds, node, "code")
    for string in docstrings:
        _mark(kinds, string, "docstring")
    return Counter(kinds)


def _mark(kinds: list[str], node: ast.expr | ast.stmt, kind: str) -> None:
    first, last = node.lineno - 1, node.end_lineno or node.lineno
    kinds[first:last] = [kind] * (last - first)


def counts(root: Path) -> dict[str, dict[str, int]]:
    """Files and lines by kind of each wing of `vo`, of all of it, and of what lies beside it."""
    wings = sorted(path for path in (root / "vo").iterdir() if (path / "__init__.py").exists())
    places = {f"vo/{wing.name}": list(wing.rglob("*.py")) for wing in wings}
    places["vo"] = list((root / "vo").rglob("*.py"))
    for name in ("data_synth", "scripts", "tests"):
        places[name] = list((root / name).rglob("*.py"))
    found: dict[str, dict[str, int]] = {}
    kinds = {file: line_kinds(file) for files in places.values() for file in files}
    for name, files in places.items():
        total = sum((kinds[file] for file in files), Counter[str]())
        found[name] = {
            "files": len(files),
            **{kind: total[kind] for kind in KINDS},
            "lines": total.total(),
        }
    return found


def words(root: Path) -> dict[str, int]:
    """Words of the pages for users, and of the experiments."""
    folders = {"docs": root / "docs", "docs/experiments": root / "docs" / "experiments"}
    return {
        name: sum(len(page.read_text(encoding="utf-8").split()) for page in folder.glob("*.md"))
        for name, folder in folders.items()
    }


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="scripts/house", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    as_json = parser.parse_args().json
    lines, pages = counts(ROOT), words(ROOT)
    if as_json:
        print(json.dumps({"lines": lines, "words": pages}, indent=2))
        return
    columns = ("files", *KINDS, "lines")
    print(f"| place | {' | '.join(columns)} |")
    print(f"| --- |{' ---: |' * len(columns)}")
    for place, row in lines.items():
        print(f"| `{place}` | {' | '.join(f'{row[column]:,}' for column in columns)} |")
    print("\n| pages | words |\n| --- | ---: |")
    for place, number in pages.items():
        print(f"| `{place}` | {number:,} |")


if __name__ == "__main__":
    main()
