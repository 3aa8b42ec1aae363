"""Console for progress and warnings, whose failures never end a run."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import IO, Any, cast

from rich.console import Console


def standard_error() -> Console:
    """A console on standard error; output to a closed pipe or a full disk is discarded."""
    file = None if sys.stderr is None else cast("IO[str]", _FailSafeFile(sys.stderr))
    return Console(file=file, stderr=True, highlight=False)


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
