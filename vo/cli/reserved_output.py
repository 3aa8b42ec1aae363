"""Standard output for one purpose alone."""

from __future__ import annotations

import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

from vo.base.errors import OutputError

_FIRST_FREE = 3  # 0 to 2 are the standard streams, even where they are closed


@contextmanager
def reserved_standard_output() -> Iterator[IO[bytes]]:
    """Standard output, unbuffered; all else that is written there goes to standard error.

    That includes the text of libraries, and child processes, which do not even keep it open.

    Raises:
        OutputError: standard output is closed.
    """
    if sys.stdout is None or sys.stdout.closed:
        raise OutputError("standard output is closed; --poses - needs it")
    try:
        number = sys.stdout.fileno()
    except (OSError, ValueError):  # no file, but an object of this process
        yield sys.stdout.buffer
        return
    sys.stdout.flush()
    reserved = fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, _FIRST_FREE)
    _redirect(number)
    try:
        with open(reserved, "wb", buffering=0, closefd=False) as file:
            yield file
    finally:
        sys.stdout.flush()
        os.dup2(reserved, number)
        os.close(reserved)


def _redirect(number: int) -> None:
    """Redirect a file descriptor to standard error, or to nowhere if that is closed."""
    try:
        os.dup2(2, number)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number)
        os.close(nowhere)
