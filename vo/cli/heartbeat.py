"""A line every ten seconds about long work, where no terminal shows a bar."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import typer

from vo.base.printable import printable

_EVERY_S = 10.0
_works: list[Callable[[], str]] = []
_last_s = 0.0


def said() -> None:
    """Note that something was printed just now."""
    global _last_s
    _last_s = time.monotonic()


@contextmanager
def doing(describe: Callable[[], str]) -> Iterator[None]:
    """Let the lines say what is being done."""
    _works.append(describe)
    try:
        yield
    finally:
        _works.remove(describe)


@contextmanager
def heartbeat(command: str) -> Iterator[None]:
    """Print a line on standard error whenever nothing was printed for ten seconds."""
    if sys.stderr is None or sys.stderr.closed or sys.stderr.isatty():
        yield
        return
    ended, begun_s = threading.Event(), time.monotonic()
    said()

    def beat() -> None:
        while not ended.wait(max(_last_s + _EVERY_S - time.monotonic(), 0.05)):
            if time.monotonic() < _last_s + _EVERY_S:
                continue
            said()
            work = _works[-1]() if _works else "working"
            with suppress(OSError, ValueError):  # closed by its reader
                seconds = time.monotonic() - begun_s
                typer.echo(printable(f"{command}: {work}, {seconds:.0f} s"), err=True)

    thread = threading.Thread(target=beat, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
