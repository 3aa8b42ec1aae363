"""A log that comes through a pipe, kept in a file for as long as the run lasts."""

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

from vo.errors import SourceError, VoError

NAME = "standard input"
"""What it is called in all that is said."""

_log = logging.getLogger(__name__)


@contextmanager
def spooled_input() -> Iterator[Path]:
    """A file that grows with what comes through standard input; gone afterwards.

    Images are found again by their place, which a pipe does not have. Errors that are raised
    inside, and what is logged to handlers of `vo`, speak of standard input instead of the file.

    Raises:
        SourceError: nothing can come through standard input.
    """
    if sys.stdin is None or sys.stdin.closed or sys.stdin.isatty():
        raise SourceError(f"nothing comes through {NAME}; as in: cat log.mcap | vo run - -o out")
    with TemporaryDirectory(prefix="vo-") as folder:
        path = Path(folder) / f"{NAME}.mcap"
        handlers = logging.getLogger("vo").handlers
        rename = _Renamed(path)
        for handler in handlers:
            handler.addFilter(rename)
        # Without buffers, whose locks a thread that still waits would hold as the program ends.
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


class _Renamed(logging.Filter):
    """Puts the name that users know in the place of the file's."""

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
            "%s is taken no further, as it is kept in %s (%s); TMPDIR chooses another folder",
            NAME,
            where,
            error.strerror,
        )
