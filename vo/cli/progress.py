"""How far a run is, on a terminal as a bar, in a log file as a line every few seconds."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich import progress as bars
from rich.console import Console
from rich.markup import escape

from vo.progress import NullProgress, Progress
from vo.types import Estimate

_LINE_EVERY_S = 5.0
_WAITING = "getting ready (the very first run compiles, which takes some seconds)"


def make_progress(console: Console | None = None, *, quiet: bool = False) -> Progress:
    """What fits the console: a bar on a terminal, lines elsewhere, nothing if quiet."""
    console = console or Console(stderr=True, highlight=False)
    if quiet:
        return NullProgress()
    return BarProgress(console) if console.is_terminal else LineProgress(console)


class BarProgress:
    """A bar with frames/s, state and matches."""

    def __init__(self, console: Console) -> None:
        self._bar = bars.Progress(
            bars.TextColumn("{task.fields[title]}"),
            bars.BarColumn(bar_width=None),
            bars.MofNCompleteColumn(),
            bars.TextColumn("{task.fields[note]}"),
            bars.TimeRemainingColumn(compact=True),
            console=console,
            transient=True,
        )

    def begin(self, name: str, total: int) -> None:
        """Show the bar."""
        self._task = self._bar.add_task("", total=total or None, title=escape(name), note=_WAITING)
        self._clock = _Clock()
        self._bar.start()

    def step(self, done: int, estimate: Estimate) -> None:
        """Move the bar."""
        note = f"{self._clock.frames_per_s():5.1f} frames/s  {_state(estimate)}"
        self._bar.update(self._task, completed=done, note=note)

    def finish(self) -> None:
        """Take the bar away."""
        self._bar.stop()


class LineProgress:
    """A line at the first frame and then every few seconds."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def begin(self, name: str, total: int) -> None:
        """Say what is to come."""
        self._total, self._next = total, 0.0
        self._clock = _Clock()
        self._say(f"{name}: {total or 'growing'} frames; {_WAITING}")

    def step(self, done: int, estimate: Estimate) -> None:
        """Say how far it is if the last time is long ago."""
        speed = self._clock.frames_per_s()
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + _LINE_EVERY_S
            of_all = f"/{self._total}" if self._total else ""
            self._say(f"frame {done}{of_all}  {speed:.1f} frames/s  {_state(estimate)}")

    def finish(self) -> None:
        """Do nothing: the table that follows says it."""

    def _say(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


class _Clock:
    """Frames per second so far, without the first frame, which may have to wait for a compiler."""

    def __init__(self) -> None:
        self._frames = -1
        self._begun = 0.0

    def frames_per_s(self) -> float:
        """To be asked once a frame."""
        self._frames += 1
        if self._frames == 0:
            self._begun = time.monotonic()
            return 0.0
        return self._frames / max(time.monotonic() - self._begun, 1e-9)


def _state(estimate: Estimate) -> str:
    if estimate.world_from_cam0 is None:
        return f"{estimate.state.value}: {estimate.reason}"
    return f"{estimate.state.value}, {estimate.matches} matches"


@contextmanager
def warnings_on(console: Console) -> Iterator[None]:
    """Inside, what the library warns of comes as a line each, above the bar if there is one."""
    handler = _LineHandler(console)
    logger = logging.getLogger("vo")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


class _LineHandler(logging.Handler):
    def __init__(self, console: Console) -> None:
        super().__init__(logging.WARNING)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        line = " ".join(f"{record.levelname.lower()}: {record.getMessage()}".split())
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)
