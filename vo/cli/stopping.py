"""Reaction of `vo run` to Ctrl-C, `kill`, a scheduler or a lost terminal."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import typer

_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


@contextmanager
def stop_signals_as_interrupts(output: Path) -> Iterator[None]:
    """Turn stop signals into KeyboardInterrupt, and an interrupt into one line and an exit status.

    An ignored signal, as under nohup, remains ignored.

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
        typer.echo(f"interrupted{_remaining_results(output, begun_s)}", err=True)
        raise typer.Exit(128 + (stop.args[0] if stop.args else signal.SIGINT)) from None
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)


def _remaining_results(output: Path, begun_s: float) -> str:
    try:
        written_s = (output / "summary.json").stat().st_mtime
    except OSError:
        written_s = 0.0
    if written_s < begun_s:
        return " before the first frame; nothing was written"
    return f"; the results so far are in {output}"
