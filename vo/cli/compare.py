"""`vo compare`: two batches of the same recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from vo.cli import options
from vo.cli.blocks import argument, option

if TYPE_CHECKING:
    from rich.console import Console

    from vo.runs.batch.comparison import Comparison

_WORSE = 4  # exit status
_MAX_ROWS = 40


def compare_command(
    before: Path = argument("Output of the first batch.", metavar="BEFORE", show_default=False),
    after: Path = argument("Output of the second batch.", metavar="AFTER", show_default=False),
    *,
    output: Path | None = option(
        "Write an HTML page too.",
        "--output",
        "-o",
        default=None,
        metavar="FILE",
        panel=options.OUTPUT,
    ),
    fail_if_worse: str | None = option(
        "Exit with 4 if a metric is certainly worse, and by more than this, or if a "
        "recording is no longer finished; such as 5%.",
        default=None,
        metavar="PERCENT",
        panel=options.OUTPUT,
    ),
    printing: options.Printing,
) -> None:
    """Compare two batches: of two versions, or of two settings.

    Ratios are those of position error, causal position error and CPU time,
    second to first, and of frames with a pose, first to second: above 1 is
    worse. Intervals have 95 % confidence, by bootstrap over the recordings.
    The worst recordings come first.

    Fail in CI if the new version is worse by more than five per cent:

      vo compare results/v1 results/v2 --fail-if-worse 5%

    Write a page:

      vo compare results/v1 results/v2 -o compare.html

    Exit status: 0, 1 error, 2 wrong usage, 4 --fail-if-worse.
    """
    from vo.cli.console import standard_output
    from vo.outputs.results.folder import write_atomically
    from vo.runs.batch.comparison import compare
    from vo.runs.batch.comparison_page import comparison_page
    from vo.runs.batch.tables import read_batch

    limit = None if fail_if_worse is None else _ratio(fail_if_worse)
    compared = compare(read_batch(before), read_batch(after))
    if output is not None:
        write_atomically(output, comparison_page(compared, str(before), str(after)))
    printing.show(compared.to_dict, lambda: _print(compared, standard_output()))
    if limit is not None and (compared.lost or compared.worse_than(limit)):
        raise typer.Exit(_WORSE)


def _ratio(text: str) -> float:
    try:
        percent = float(text.strip().removesuffix("%"))
    except ValueError:
        percent = -1.0
    if not 0.0 <= percent < 1e6:
        raise typer.BadParameter(f"--fail-if-worse is {text!r}; give a percentage such as 5%")
    return percent / 100.0


def _print(compared: Comparison, console: Console) -> None:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from vo.cli.console import print_table
    from vo.runs.batch.comparison import METRICS
    from vo.runs.batch.comparison_page import NAMES

    style = box.SIMPLE_HEAD if console.is_terminal else box.ASCII2
    table = Table(box=style, pad_edge=False)
    table.add_column("recording")
    table.add_column("before")
    table.add_column("after")
    for metric in METRICS:
        table.add_column(NAMES[metric], justify="right")
    for row in compared.rows[:_MAX_ROWS]:
        cells = [f"{row.ratios[m]:.3f}" if m in row.ratios else "–" for m in METRICS]
        results = ["–" if r is None else r.status.value for r in (row.before, row.after)]
        table.add_row(escape(row.name), *results, *cells)
    print_table(console, table)
    console.print()
    if len(compared.rows) > _MAX_ROWS:
        console.print(f"the worst {_MAX_ROWS} of {len(compared.rows)}")
    for change in compared.changes:
        console.print(
            f"{NAMES[change.metric]:<14} {change.ratio:.3f} "
            f"(95 %: {change.low:.3f} to {change.high:.3f}, {change.recordings} recordings)",
            highlight=False,
        )
    if compared.lost:
        console.print(f"no longer finished: {', '.join(compared.lost)}", markup=False)
