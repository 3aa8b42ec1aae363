"""Where progress and warnings are told, which must never cost a run."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import IO, Any, cast

from rich.console import Console


def standard_error() -> Console:
    """A console on standard error; what a closed pipe or a full disk does not take is lost."""
    file = None if sys.stderr is None else cast("IO[str]", _Forgiving(sys.stderr))
    return Console(file=file, stderr=True, highlight=False)


class _Forgiving:
    """A text file whose failures to write go unnoticed."""

    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def write(self, text: str) -> int:
        """As far as that goes."""
        with suppress(OSError):
            self._file.write(text)
        return len(text)

    def flush(self) -> None:
        """The same."""
        with suppress(OSError):
            self._file.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)
