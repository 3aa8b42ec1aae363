"""Rows of the table of robustness in a file, written one by one as they are measured."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from robustness_run import Outcome
from robustness_table import CleanRow, Row


class Store:
    """Rows of this and of earlier calls as JSON Lines; processes may append to the same file.

    Rows of earlier calls count only if they have the same commit, without changes since.
    """

    def __init__(self, file: Path | None, vo: Path) -> None:
        self._file = file
        self._commit = _commit(vo.parent)

    def find(self, name: str) -> Row | CleanRow | None:
        """The row of this name, None if it has not been measured."""
        if self._file is None or not self._file.is_file() or self._commit.endswith("dirty"):
            return None
        lines = self._file.read_text(encoding="utf-8").splitlines()
        found = (_values(line) for line in reversed(lines))
        same = (r for r in found if r and (r["name"], r["commit"]) == (name, self._commit))
        return next((_row(each) for each in same), None)

    def add(self, name: str, row: Row | CleanRow, seconds: float) -> None:
        """Append a row."""
        if self._file is None:
            return
        about = {"name": name, "commit": self._commit, "seconds": round(seconds, 1)}
        with self._file.open("a", encoding="utf-8") as out:
            out.write(f"\n{json.dumps({**row.to_dict(), **about}, ensure_ascii=False)}\n")


def _values(line: str) -> dict[str, Any]:
    """A line's values, none where it is empty or was broken off."""
    try:
        return dict(json.loads(line))
    except ValueError:
        return {}


def _row(values: dict[str, Any]) -> Row | CleanRow:
    outcome = _outcome(values["outcome"])
    if "clean" not in values:
        return CleanRow(values["name"], outcome)
    words = (values[key] for key in ("situation", "variant", "clip"))
    clean = _outcome(values["clean"])
    return Row(*words, outcome, clean, values["max_ate_m"], values["is_visible"])


def _outcome(values: dict[str, Any]) -> Outcome:
    return Outcome(**{**values, "faults": tuple(values["faults"])})


def _commit(folder: Path) -> str:
    """Commit of the code that is tested, `-dirty` with changes, `dirty` outside a repository."""
    command = ["git", "-C", str(folder), "describe", "--always", "--abbrev=40", "--dirty"]
    found = subprocess.run([*command, "--exclude=*"], capture_output=True, text=True, check=False)
    return found.stdout.strip() or "dirty"
