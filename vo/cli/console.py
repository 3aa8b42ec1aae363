"""Consoles of rich, in which text from files has no control characters, and tables of numbers."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import suppress
from typing import IO, Any, cast

from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.table import Table

from vo.base.printable import printable
from vo.cli.flags import in_flags
from vo.cli.heartbeat import said

_ANY_WIDTH = 1000


class SafeConsole(Console):
    """A console that prints options as flags, and control characters as `printable` writes them."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print texts and others, as rich does."""
        said()
        super().print(*map(in_flags, objects), **options)

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        """The text of the terminal, with rich's own control codes."""
        return super()._render_buffer(
            segment if segment.control else segment._replace(text=printable(segment.text))
            for segment in buffer
        )


def standard_output(*, quiet: bool = False) -> Console:
    """A console on standard output."""
    return SafeConsole(highlight=False, emoji=False, quiet=quiet)


def standard_error(*, quiet: bool = False) -> Console:
    """A console on standard error; output to a closed pipe or a full disk is discarded."""
    file = None if sys.stderr is None else cast("IO[str]", _FailSafeFile(sys.stderr))
    return SafeConsole(file=file, stderr=True, highlight=False, emoji=False, quiet=quiet)


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
