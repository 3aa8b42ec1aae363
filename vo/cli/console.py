"""Console for progress and warnings, whose failures never end a run, and tables of numbers."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import IO, Any, cast

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table

_ANY_WIDTH = 1000


def standard_error() -> Console:
    """A console on standard error; output to a closed pipe or a full disk is discarded."""
    file = None if sys.stderr is None else cast("IO[str]", _FailSafeFile(sys.stderr))
    return Console(file=file, stderr=True, highlight=False)


def print_table(console: Console, table: Table) -> None:
    """Print a table in the width that it needs: a narrow terminal breaks its lines, cuts none."""
    console.print(_Whole(table), crop=False)


class _Whole:
    """A table that does not shrink with the terminal, so that no number is cut."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        needed = console.measure(self._table, options=options.update(width=_ANY_WIDTH)).maximum
        yield from console.render(self._table, options.update(width=needed))


class _FailSafeFile:
    """A text file that ignores write errors."""

    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def write(self, text: str) -> int:
        """Write the text if possible."""
        with suppress(OSError):
            self._file.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush if possible."""
        with suppress(OSError):
            self._file.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)
