"""How far a run is, on a terminal as a bar, in a log file as a line every few seconds."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich import progress as bars
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.text import Text

from vo.progress import NullProgress, Progress
from vo.types import Estimate, State

_LINE_EVERY_S = 5.0
_WORTH_TELLING_PX = 0.05
_STYLES = {State.STARTING: "yellow", State.TRACKING: "green", State.LOST: "bold red"}
_WAITING = "getting ready (the very first run compiles, which takes half a minute)"


def make_progress(console: Console | None = None, *, quiet: bool = False) -> Progress:
    """What fits the console: a bar on a terminal, lines elsewhere, nothing if quiet."""
    console = console or Console(stderr=True, highlight=False)
    if quiet:
        return NullProgress()
    return BarProgress(console) if console.is_terminal else LineProgress(console)


class BarProgress:
    """A bar, and under it a line on how tracking goes."""

    def __init__(self, console: Console) -> None:
        self._bar = bars.Progress(
            bars.TextColumn("{task.fields[title]}"),
            bars.BarColumn(bar_width=None),
            bars.MofNCompleteColumn(),
            bars.TimeRemainingColumn(compact=True),
            bars.TextColumn("left"),
            console=console,
            expand=True,
        )
        self._line = Text(_WAITING, style="dim")
        self._live = Live(self._shown(), console=console, transient=True)

    def begin(self, name: str, total: int) -> None:
        """Show the bar."""
        self._task = self._bar.add_task("", total=total or None, title=escape(name))
        self._counts = _Counts()
        self._live.start(refresh=True)  # the first frame may be done before the first refresh

    def step(self, done: int, estimate: Estimate) -> None:
        """Move the bar."""
        self._counts.add(estimate)
        self._bar.update(self._task, completed=done)
        self._line = Text(overflow="ellipsis", no_wrap=True)
        self._line.append(f"{estimate.state.value:<9}", style=_STYLES[estimate.state])
        self._line.append(f" {self._counts.line(estimate)}")
        self._live.update(self._shown())

    def finish(self) -> None:
        """Take the bar away."""
        self._live.stop()

    def _shown(self) -> Group:
        return Group(self._bar, self._line)


class LineProgress:
    """A line at the first frame and then every few seconds."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def begin(self, name: str, total: int) -> None:
        """Say what is to come."""
        self._total, self._next = total, 0.0
        self._counts = _Counts()
        self._say(f"{name}: {total or 'growing'} frames; {_WAITING}")

    def step(self, done: int, estimate: Estimate) -> None:
        """Say how far it is if the last time is long ago."""
        self._counts.add(estimate)
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + _LINE_EVERY_S
            of_all = f"/{self._total}" if self._total else ""
            told = f"{estimate.state.value}, {self._counts.line(estimate)}"
            self._say(f"frame {done}{of_all}  {told}")

    def finish(self) -> None:
        """Do nothing: the table that follows says it."""

    def _say(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


class _Counts:
    """What has been seen so far, for people who wait."""

    def __init__(self) -> None:
        self._frames = -1
        self._begun = 0.0
        self._keyframes = self._lost = 0

    def add(self, estimate: Estimate) -> None:
        """Take in a frame."""
        self._frames += 1
        if self._frames == 0:  # it may have had to wait for a compiler
            self._begun = time.monotonic()
        self._keyframes += estimate.is_keyframe
        self._lost += estimate.state == State.LOST

    def frames_per_s(self) -> float:
        """So far, without the first frame."""
        return self._frames / max(time.monotonic() - self._begun, 1e-9) if self._frames > 0 else 0.0

    def line(self, estimate: Estimate) -> str:
        """Speed, how this frame went, and what there is so far."""
        parts = [f"{self.frames_per_s():.1f} frames/s"]
        if estimate.world_from_cam0 is None:
            parts.append(estimate.reason)
        else:
            parts.append(f"{estimate.inliers} of {estimate.matches} matches agree")
        parts.append(f"{self._keyframes} keyframes")
        if self._lost:
            parts.append(f"lost in {self._lost} frames")
        if abs(estimate.disparity_offset_px) >= _WORTH_TELLING_PX:
            parts.append(f"disparities off by {estimate.disparity_offset_px:+.2f} px")
        return ", ".join(parts)


@contextmanager
def warnings_on(console: Console) -> Iterator[None]:
    """Inside, what the library warns of comes as one line each, above the bar if there is one."""
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
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        line = " ".join(f"{record.levelname.lower()}: {record.getMessage()}".split())
        if line in self._said:  # as of a file that is read twice
            return
        self._said.add(line)
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)
