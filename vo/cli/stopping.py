"""Reaction of `vo run` to Ctrl-C, `kill`, a scheduler or a lost terminal."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import typer

from vo.cli.echo import echo

if TYPE_CHECKING:
    from vo.runs.progress import Progress

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Reaction to stop signals: a KeyboardInterrupt, or nothing once the results are saved."""

    def __init__(self) -> None:
        self._are_ignored = False

    def ignore(self) -> None:
        """Ignore signals from now on: there is nothing to stop but the clean-up."""
        self._are_ignored = True

    def obey(self) -> None:
        """React to signals again."""
        self._are_ignored = False

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if not self._are_ignored:
            raise KeyboardInterrupt(number)


class IgnoringAtEnd:
    """A progress display at whose end stop signals become ignored."""

    def __init__(self, progress: Progress, signals: StopSignals) -> None:
        self._signals = signals
        self._progress = progress
        self.begin, self.step = progress.begin, progress.step

    def finish(self) -> None:
        """End the display; the results are being saved, and signals are held back until then."""
        self._signals.ignore()
        self._progress.finish()


@contextmanager
def stop_signals_as_interrupts(output: Path) -> Iterator[StopSignals]:
    """Turn stop signals into KeyboardInterrupt, and an interrupt into one line and an exit status.

    An ignored signal, as under nohup, remains ignored.

    Raises:
        typer.Exit: interrupted; the exit status is 128 + signal.
    """
    begun_s = time.time()
    previous = {}
    signals = StopSignals()
    if threading.current_thread() is threading.main_thread():
        defaults = (signal.SIG_DFL, signal.default_int_handler)
        unhandled = [number for number in _SIGNALS if signal.getsignal(number) in defaults]
        previous = {number: signal.signal(number, signals.handle) for number in unhandled}
    try:
        yield signals
    except KeyboardInterrupt as stop:
        signals.ignore()
        number = stop.args[0] if stop.args else signal.SIGINT
        what = "interrupted" if number != signal.SIGPIPE else "nothing reads the poses any more"
        echo(f"{what}{_remaining_results(output, begun_s)}", err=True)
        raise typer.Exit(128 + number) from None
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def interrupts_named(output: Path) -> Iterator[None]:
    """Turn Ctrl-C into one line, that a file was not written, and exit status 130."""
    try:
        yield
    except KeyboardInterrupt:
        echo(f"interrupted; {output} was not written", err=True)
        raise typer.Exit(130) from None


def _remaining_results(output: Path, begun_s: float) -> str:
    try:
        written_s = (output / "summary.json").stat().st_mtime
    except OSError:
        written_s = 0.0
    if written_s < begun_s:
        return " before the first frame; nothing was written"
    return f"; the results so far are in {output}"
