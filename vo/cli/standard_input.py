"""Recording from standard input, kept in a temporary file during the run."""

from __future__ import annotations

import logging
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from vo.base.errors import SourceError, VoError

NAME = "standard input"
"""Name of the recording in messages and results."""

_log = logging.getLogger(__name__)


@contextmanager
def spooled_input() -> Iterator[Path]:
    """A temporary file that grows with the data from standard input.

    A file is needed because images are read by their offset. Errors raised inside, and messages
    logged to handlers of `vo`, contain "standard input" instead of the path of the file.

    Raises:
        SourceError: standard input is closed or a terminal.
    """
    if sys.stdin is None or sys.stdin.closed or sys.stdin.isatty():
        raise SourceError(f"no data on {NAME}; use it like this: cat log.mcap | vo run - -o out")
    with TemporaryDirectory(prefix="vo-") as folder:
        path = Path(folder) / f"{NAME}.mcap"
        handlers = logging.getLogger("vo").handlers
        rename = _PathReplacement(path)
        for handler in handlers:
            handler.addFilter(rename)
        # Unbuffered: a thread that is still reading would hold the lock of a buffer at exit.
        source = open(sys.stdin.fileno(), "rb", buffering=0, closefd=False)  # noqa: SIM115
        target = path.open("wb", buffering=0)
        threading.Thread(target=_copy, args=(source, target), daemon=True).start()
        try:
            yield path
        except VoError as error:
            raise type(error)(str(error).replace(str(path), NAME)) from error
        finally:
            for handler in handlers:
                handler.removeFilter(rename)


class _PathReplacement(logging.Filter):
    """Replaces the path of the temporary file in log messages."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = str(path)

    def filter(self, record: logging.LogRecord) -> bool:
        record.msg, record.args = record.getMessage().replace(self._path, NAME), ()
        return True


def _copy(source: IO[bytes], target: IO[bytes]) -> None:
    try:
        shutil.copyfileobj(source, target)
    except OSError as error:
        where = Path(target.name).parent.parent
        _log.warning(
            "%s is read no further, as %s cannot store it (%s); set TMPDIR to another folder",
            NAME,
            where,
            error.strerror,
        )
