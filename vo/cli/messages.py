"""Messages of the library as lines on a console, which is made for the first of them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from vo.cli.echo import echo_error

if TYPE_CHECKING:  # rich takes 20 ms, and a quiet run does without it
    from rich.console import Console


@contextmanager
def warnings_on(console: Callable[[], Console] | None, *, quiet: bool = False) -> Iterator[None]:
    """Print each warning of the library once, as one line, above a progress bar if on a console.

    Also print when functions are compiled, and where poses are served, unless quiet; with --verbose
    print all messages.
    """
    handler = _LineHandler(console)
    logger = logging.getLogger("vo")
    talkative = [
        logging.getLogger(name)
        for name in ("vo.base.compiling", "vo.outputs.streaming", "vo.engine.learned")
    ]
    logger.addHandler(handler)
    if not quiet:
        for each in talkative:
            each.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        for each in talkative:
            each.setLevel(logging.NOTSET)


@contextmanager
def details_on(console: Callable[[], Console]) -> Iterator[None]:
    """Print the messages of the library below warnings, with --verbose, as one line each."""
    handler = _LineHandler(console)
    handler.addFilter(lambda record: record.levelno < logging.WARNING)
    logger = logging.getLogger("vo")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


class _LineHandler(logging.Handler):
    """Prints messages that the levels of the loggers let pass, without a console plainly."""

    def __init__(self, console: Callable[[], Console] | None) -> None:
        super().__init__()
        self._console = None if console is None else cache(console)
        self._printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        prefix = f"{record.levelname.lower()}: " if record.levelno >= logging.WARNING else ""
        line = " ".join(f"{prefix}{record.getMessage()}".split())
        if line in self._printed:  # for example, of a file that is read twice
            return
        self._printed.add(line)
        if self._console is None:
            echo_error(line)
        else:
            self._console().print(line, markup=False, highlight=False, soft_wrap=True)
