"""Progress of a run: a bar on a terminal, otherwise a line every few seconds."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from rich import progress as bars
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.text import Text

from vo.base.failures import describe
from vo.base.printable import counted
from vo.base.types import Estimate, State
from vo.cli.console import standard_error
from vo.cli.heartbeat import doing
from vo.runs.progress import NullProgress, Progress

_log = logging.getLogger(__name__)
_LINE_EVERY_S = 5.0
_MIN_SHOWN_OFFSET_PX = 0.05
_STYLES = {State.STARTING: "yellow", State.TRACKING: "green", State.LOST: "bold red"}
_WAITING = "getting ready"


def make_progress(console: Console | None = None, *, quiet: bool = False) -> Progress:
    """Progress display for the console: a bar on a terminal, else lines; none if quiet."""
    console = console or standard_error()
    if quiet:
        return NullProgress()
    return BarProgress(console) if console.is_terminal else LineProgress(console)


class BarProgress:
    """A bar, and below it a line about tracking."""

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
        self._live = Live(self._content(), console=console, transient=True)

    def begin(self, name: str, total: int) -> None:
        """Show the bar."""
        self._task = self._bar.add_task("", total=total or None, title=escape(name))
        self._counts = _Counts()
        self._live.start(refresh=True)  # before the first frame

    def step(self, done: int, estimate: Estimate) -> None:
        """Advance the bar."""
        self._counts.add(estimate)
        self._bar.update(self._task, completed=done)
        self._line = Text(overflow="ellipsis", no_wrap=True)
        self._line.append(f"{estimate.state.value:<9}", style=_STYLES[estimate.state])
        self._line.append(f" {self._counts.line(estimate)}")
        self._live.update(self._content())

    def finish(self) -> None:
        """Remove the bar."""
        self._live.stop()

    def _content(self) -> Group:
        return Group(self._bar, self._line)


class LineProgress:
    """A line at the first frame and then every few seconds."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def begin(self, name: str, total: int) -> None:
        """Print name and length of the recording."""
        self._total, self._next = total, 0.0
        self._counts = _Counts()
        frames = counted(total, "frame") if total else "an unknown number of frames"
        self._print(f"{name}: {frames}; {_WAITING}")

    def step(self, done: int, estimate: Estimate) -> None:
        """Print a line if the last one is several seconds old."""
        self._counts.add(estimate)
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + _LINE_EVERY_S
            of_all = f"/{self._total}" if self._total else ""
            status = f"{estimate.state.value}, {self._counts.line(estimate)}"
            self._print(f"frame {done}{of_all}  {status}")

    def finish(self) -> None:
        """Do nothing, as a summary follows."""

    def _print(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


@contextmanager
def frame_bar(
    console: Console, first: str, then: str = ""
) -> Iterator[tuple[bars.Progress, Callable[[int, int], None]]]:
    """A bar on a terminal, and a function that is called with the frames done and their total.

    Args:
        console: where it is shown.
        first: what is done before the first frame.
        then: what is done with frames, if it is something else.
    """
    columns = ("{task.description}", bars.BarColumn(), bars.MofNCompleteColumn())
    times = (bars.TimeElapsedColumn(), bars.TimeRemainingColumn())
    is_hidden = console.quiet or not console.is_terminal
    with bars.Progress(*columns, *times, console=console, disable=is_hidden, transient=True) as bar:
        task = bar.add_task(first, total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, description=then or first, completed=done, total=total)

        with doing(lambda: _counted(bar)):
            yield bar, show


def _counted(bar: bars.Progress) -> str:
    """What a bar shows, in words."""
    task = bar.tasks[0]
    title = (task.description or task.fields["title"]).replace("\\[", "[")  # of markup
    return f"{title} {task.completed:.0f}/{task.total:.0f}" if task.total else title


class Step(Protocol):
    """Called with what a step is about, and with the steps done, if not one more."""

    def __call__(self, name: str, done: int | None = None) -> None: ...  # noqa: D102


@contextmanager
def counting(console: Console, title: str, total: int) -> Iterator[Step]:
    """A bar on a terminal; the function that it gives is called at each step."""
    columns = (
        bars.TextColumn("{task.fields[title]}"),
        bars.BarColumn(bar_width=None),
        bars.MofNCompleteColumn(),
        bars.TimeRemainingColumn(compact=True),
        bars.TextColumn("left"),
    )
    is_hidden = console.quiet or not console.is_terminal
    with bars.Progress(
        *columns, console=console, expand=True, transient=True, disable=is_hidden
    ) as bar:
        task = bar.add_task("", total=total, title=escape(title))
        count = -1

        def step(name: str, done: int | None = None) -> None:
            nonlocal count
            count = count + 1 if done is None else done
            bar.update(task, completed=count, title=escape(f"{title}: {name}"))

        with doing(lambda: _counted(bar)):
            yield step


class _Counts:
    """Counters over the frames so far."""

    def __init__(self) -> None:
        self._frames = -1
        self._begun = 0.0
        self._keyframes = self._lost = 0
        self._state: State | None = None

    def add(self, estimate: Estimate) -> None:
        """Count a frame."""
        self._frames += 1
        if self._frames == 0:  # it may include compilation
            self._begun = time.monotonic()
        if estimate.state != self._state:
            why = describe(estimate.failure)
            reason = f" ({why})" if why else ""
            _log.info("frame %d: %s%s", estimate.frame_index, estimate.state.value, reason)
            self._state = estimate.state
        self._keyframes += estimate.is_keyframe
        self._lost += estimate.state == State.LOST

    def frames_per_s(self) -> float:
        """Average speed without the first frame."""
        return self._frames / max(time.monotonic() - self._begun, 1e-9) if self._frames > 0 else 0.0

    def line(self, estimate: Estimate) -> str:
        """Speed, result of this frame, and counters."""
        parts = [f"{self.frames_per_s():.1f} frames/s"]
        if estimate.world_from_cam0 is None:
            parts.append(describe(estimate.failure))
        else:
            parts.append(f"{estimate.inliers} of {estimate.matches} matches agree")
        parts.append(f"{self._keyframes} keyframe{'s' * (self._keyframes != 1)}")
        if self._lost:
            parts.append(f"lost in {self._lost} frame{'s' * (self._lost != 1)}")
        if estimate.dropped:
            parts.append(f"{estimate.dropped} dropped")
        if abs(estimate.disparity_offset_px) >= _MIN_SHOWN_OFFSET_PX:
            parts.append(f"disparity bias {estimate.disparity_offset_px:+.2f} px")
        return ", ".join(parts)
