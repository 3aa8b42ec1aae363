"""Progress of a batch, and its results as a text table."""

from __future__ import annotations

import time

from rich import box
from rich import progress as bars
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vo.base.printable import counted
from vo.cli.console import print_table
from vo.runs.batch.batch import BatchResult
from vo.runs.batch.datasets import table_of
from vo.runs.batch.job import JobResult
from vo.runs.batch.planning import Plan
from vo.runs.batch.tables import PAGE, totals

_MAX_TEXT = 70  # of an error in the table
_MAX_ROWS = 40  # worst first, if there are more


class BatchBar:
    """A bar with the time left on a terminal, else a line for each recording."""

    def __init__(self, console: Console, *, quiet: bool) -> None:
        self._console = console
        self._is_quiet = quiet
        self._bar = bars.Progress(
            bars.TextColumn("recordings"),
            bars.BarColumn(bar_width=None),
            bars.MofNCompleteColumn(),
            bars.TimeRemainingColumn(compact=True),
            bars.TextColumn("left, {task.fields[failed]} failed"),
            console=console,
            expand=True,
            transient=True,
        )

    def begin(self, total: int) -> None:
        """Show the bar."""
        self._total, self._failed, self._kept = total, 0, 0
        self._begun = time.monotonic()
        if not self._is_quiet and self._console.is_terminal:
            self._task = self._bar.add_task("", total=total, failed=0)
            self._bar.start()

    def step(self, result: JobResult, done: int, *, is_kept: bool) -> None:
        """Advance the bar."""
        self._failed += not result.is_done
        self._kept += is_kept
        if self._is_quiet:
            return
        if self._console.is_terminal:
            self._bar.update(self._task, completed=done, failed=self._failed)
            if not result.is_done:
                self._print(f"{result.name}: {result.status}: {result.error}")
            return
        if not is_kept:
            self._print(
                f"{done}/{self._total}  {result.name}: {_outcome(result)}{self._left(done)}"
            )

    def finish(self) -> None:
        """Remove the bar."""
        self._bar.stop()
        if self._kept and not self._is_quiet:
            self._print(f"{counted(self._kept, 'finished result')} kept")

    def _left(self, done: int) -> str:
        new = done - self._kept
        seconds = (time.monotonic() - self._begun) / max(new, 1) * (self._total - done)
        return f" ({seconds:.0f} s left)" if self._total > done else ""

    def _print(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


def print_batch(result: BatchResult, plan: Plan, console: Console) -> None:
    """Print a row for each recording, worst first if there are many, and figures over all."""
    rows = sorted(result.results, key=_badness) if len(result.results) > _MAX_ROWS else None
    shown = result.results if rows is None else rows[:_MAX_ROWS]
    print_table(console, _table(shown, plain=not console.is_terminal))
    over_all = totals(result.results)
    console.print()
    if rows is not None:
        _line(console, "shown", f"the worst {_MAX_ROWS} of {len(rows)}")
    counts = ", ".join(f"{n} {status}" for status, n in over_all.by_status.items())
    kept = f", {result.kept} kept" if result.kept else ""
    _line(console, "recordings", f"{over_all.recordings}: {counts}{kept}")
    if over_all.untrusted:
        _line(console, "doubted", f"{counted(over_all.untrusted, 'path')} not to be trusted")
    if over_all.median_ate_m is not None:
        _line(console, "median ATE", f"{over_all.median_ate_m:.4g} m")
    _line(console, "time", f"{result.wall_s:.1f} s, CPU of all runs {over_all.cpu_s:.1f} s")
    for name, source in list(plan.renamed.items())[:10]:
        _line(console, "renamed", f"{name} is {source}")
    for folder in plan.left_out[:10]:
        _line(console, "left out", f"{folder}: no recording in it")
    if plan.dataset is not None:
        console.print()
        console.print(table_of(plan.dataset, result.results), markup=False, soft_wrap=True)
    _line(console, "overview", str(result.output / PAGE))


def _line(console: Console, name: str, value: str) -> None:
    console.print(f"[bold]{name:<10}[/]", escape(value), soft_wrap=True)


def _badness(result: JobResult) -> tuple[int, float, str]:
    grade = 0 if not result.is_done else 1 if result.trusted is False else 2
    ratio = 0.0 if result.tracked_ratio is None else result.tracked_ratio
    return grade, ratio, result.name


def _outcome(result: JobResult) -> str:
    if not result.is_done:
        return f"{result.status}: {result.error}"
    ate = "" if result.ate_m is None else f", ATE {result.ate_m:.4g} m"
    return f"{result.verdict}, {100 * (result.tracked_ratio or 0.0):.0f} % of the frames{ate}"


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}…"


def _table(results: tuple[JobResult, ...] | list[JobResult], *, plain: bool) -> Table:
    table = Table(box=box.ASCII2 if plain else box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("recording")
    table.add_column("result")
    for name in ("poses", "segments", "ATE, m", "frames/s", "s"):
        table.add_column(name, justify="right")
    for r in results:
        what = r.verdict if r.is_done else f"{r.status}: {_shortened(r.error or '')}"
        table.add_row(
            escape(r.name),
            escape(what or ""),
            "–" if r.tracked_ratio is None else f"{100 * r.tracked_ratio:.1f} %",
            "–" if r.segments is None else str(r.segments),
            "–" if r.ate_m is None else f"{r.ate_m:.4g}",
            "–" if r.frames_per_s is None else f"{r.frames_per_s:.1f}",
            "–" if r.wall_s is None else f"{r.wall_s:.1f}",
        )
    return table
