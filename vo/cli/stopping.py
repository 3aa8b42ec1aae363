"""Reaction of `vo run` to Ctrl-C, `kill`, a scheduler or a lost terminal."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import typer

from vo.cli.echo import echo

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def stop_signals_as_interrupts(output: Path) -> Iterator[None]:
    """Turn stop signals into KeyboardInterrupt, and an interrupt into one line and an exit status.

    An ignored signal, as under nohup, remains ignored. An interrupt after the end of the run, while
    its summary is printed, has no effect but that.

    Raises:
        typer.Exit: interrupted; the exit status is 128 + signal.
    """
    begun_s = time.time()
    previous = {}
    if threading.current_thread() is threading.main_thread():
        unhandled = [number for number in _SIGNALS if signal.getsignal(number) == signal.SIG_DFL]
        previous = {number: signal.signal(number, _interrupt) for number in unhandled}
    try:
        yield
    except KeyboardInterrupt as stop:
        status = _written_status(output, begun_s)
        if status == "finished":
            return
        written = f"; the results so far are in {output}"
        if status is None:
            written = " before the first frame; nothing was written"
        echo(f"interrupted{written}", err=True)
        raise typer.Exit(128 + (stop.args[0] if stop.args else signal.SIGINT)) from None
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)


def _written_status(output: Path, begun_s: float) -> str | None:
    """Status in the summary that was written since a time, None if there is none."""
    file = output / "summary.json"
    try:
        if file.stat().st_mtime < begun_s:
            return None
        return str(json.loads(file.read_text(encoding="utf-8"))["status"])
    except (OSError, ValueError, KeyError):
        return None
