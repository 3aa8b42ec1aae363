"""A log that comes through a pipe, kept in a file for as long as the run lasts."""

from __future__ import annotations

import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def spooled_input() -> Iterator[Path]:
    """A file that grows with what comes through standard input; gone afterwards.

    Images are found again by their place, which a pipe does not have.
    """
    with TemporaryDirectory(prefix="vo-") as folder:
        path = Path(folder) / "stdin.mcap"
        # Without buffers, whose locks a thread that still waits would hold as the program ends.
        source = open(sys.stdin.fileno(), "rb", buffering=0, closefd=False)  # noqa: SIM115
        target = path.open("wb", buffering=0)
        threading.Thread(target=shutil.copyfileobj, args=(source, target), daemon=True).start()
        yield path
