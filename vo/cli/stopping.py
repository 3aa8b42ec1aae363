"""What happens when a run is told to stop: by Ctrl-C, `kill`, a scheduler or a lost terminal."""

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
def stops_gently(output: Path) -> Iterator[None]:
    """Inside, all of them end the run as Ctrl-C does; then say where it is, and exit 128 + signal.

    A signal that is ignored, as under nohup, stays so.
    """
    begun_s = time.time()
    before = {}
    if threading.current_thread() is threading.main_thread():
        taken = [number for number in _SIGNALS if signal.getsignal(number) == signal.SIG_DFL]
        before = {number: signal.signal(number, _stop) for number in taken}
    try:
        yield
    except KeyboardInterrupt as stop:
        typer.echo(f"interrupted{_what_is_left(output, begun_s)}", err=True)
        raise typer.Exit(128 + (stop.args[0] if stop.args else signal.SIGINT)) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)


def _what_is_left(output: Path, begun_s: float) -> str:
    try:
        written_s = (output / "summary.json").stat().st_mtime
    except OSError:
        written_s = 0.0
    if written_s < begun_s:
        return " before the first frame; nothing was written"
    return f"; what was computed until now is in {output}"
