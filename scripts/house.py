"""Counts the lines of the code by wing, and the words of the documentation.

Usage: scripts/house [--json]
"""

from __future__ import annotations

import argparse
import ast
import json
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
KINDS = ("code", "docstring", "comment", "blank")


def line_kinds(path: Path) -> Counter[str]:
    """Number of lines of a module by kind; a comment behind code is code."""
    text = path.read_text(encoding="utf-8")
    kind_of = dict.fromkeys(range(1, len(text.splitlines()) + 1), "blank")
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(file.readline):
            if token.type in (tokenize.NL, tokenize.NEWLINE, tokenize.ENDMARKER):
                continue
            kind = "comment" if token.type == tokenize.COMMENT else "code"
            for line in range(token.start[0], token.end[0] + 1):
                if line in kind_of and kind_of[line] != "code" and token.string.strip():
                    kind_of[line] = kind
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            string = node.body[0]
            lines = range(string.lineno, (string.end_lineno or string.lineno) + 1)
            kind_of.update(dict.fromkeys(lines, "docstring"))
    return Counter(kind_of.values())


def counts(root: Path) -> dict[str, dict[str, int]]:
    """Files and lines by kind of each wing of `vo`, of all of it, and of what lies beside it."""
    wings = sorted(path for path in (root / "vo").iterdir() if (path / "__init__.py").exists())
    places = {f"vo/{wing.name}": list(wing.rglob("*.py")) for wing in wings}
    places["vo"] = list((root / "vo").rglob("*.py"))
    for name in ("data_synth", "scripts", "tests"):
        places[name] = list((root / name).rglob("*.py"))
    found = {}
    for name, files in places.items():
        total = sum((line_kinds(file) for file in files), Counter[str]())
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
