"""`vo sweep`: a search for settings over a set of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vo.cli import options
from vo.cli.batch import Dataset, Manifest, RunOn, Sources, make_engine
from vo.cli.blocks import Only, block, option

if TYPE_CHECKING:
    from rich.console import Console

    from vo.runs.batch.sweep import SweepResult

_SEARCH = "What is tried"  # heading of options in `--help`
_MAX_ROWS = 20


@block(_SEARCH)
class Search:
    """What is tried."""

    tried: list[str] | None = option(
        "Values of a setting, 500,1000,2000, or a range, 0.5..2; may be repeated.",
        "--try",
        default=None,
        metavar="KEY=VALUES",
        show_default=False,
    )
    trials: int | None = option(
        "Number of trials, chosen by Optuna (extra `sweep`).",
        default=None,
        min=1,
        metavar="N",
        show_default="all combinations of the values",
    )
    held_out: float = option(
        "Ratio of the recordings that no trial runs on, but the best settings at the end.",
        default=0.3,
        min=0.0,
        max=0.9,
        metavar="RATIO",
    )
    max_cpu: float | None = option(
        "Greatest CPU time, relative to the unchanged settings.",
        default=None,
        min=0.1,
        metavar="RATIO",
        show_default="no limit",
    )
    seed: int = option("Of all choices.", default=0, min=0, metavar="N")


def sweep_command(
    *,
    sources: Sources = None,
    output: Path = option(
        "Folder for the batches of all trials, best.yaml and sweep.json.",
        "--output",
        "-o",
        default=Path("sweep"),
        metavar="FOLDER",
        panel=options.OUTPUT,
    ),
    search: Search,
    manifest: Manifest = None,
    dataset: Dataset = None,
    reading: Annotated[options.Reading, Only("calibration", "mode")],
    config: options.Config = "default",
    overrides: options.Overrides = None,
    runs: Annotated[RunOn, Only("jobs", "ray", "timeout", "retries")],
    printing: options.Printing,
) -> None:
    """Try settings on recordings with ground truth, and write the best ones.

    Each trial is a batch; its score is the ratio of its position errors (ATE)
    to those of the unchanged settings, with frames without a pose counted
    against it. The best settings are written to best.yaml, for `vo run
    --config`, and compared with the unchanged ones on recordings that no
    trial has seen. Called again, the same command goes on where it was.

    Try all combinations of some values:

      vo sweep drives/ -o sweep/ --try features.count=800,1500,3000 --try window.iterations=4,8

    Let Optuna choose 40 trials in ranges, of at most 1.2 times the CPU time:

      vo sweep drives/ -o sweep/ --try keyframes.max_gap_s=0.3..3 --trials 40 --max-cpu 1.2

    Exit status: 0, 1 error, 2 wrong usage, 130 Ctrl-C.
    """
    from vo.cli.batch_table import BatchBar
    from vo.cli.console import standard_error, standard_output
    from vo.runs.batch.job import Job
    from vo.runs.batch.planning import plan
    from vo.runs.batch.sweep import SweepOptions, check_spaces, parse_space, run_sweep

    if not sources and manifest is None:
        raise typer.BadParameter("give recordings, folders or URLs, or a --manifest")
    if not search.tried:
        raise typer.BadParameter("give settings to --try, such as features.count=800,1500")
    shared = Job(
        "",
        "",
        config,
        tuple(overrides or ()),
        reading.mode.value,
        None if reading.calibration is None else str(reading.calibration),
    )
    spaces = [parse_space(text) for text in search.tried]
    check_spaces(spaces, shared)
    console = standard_error()

    def progress(name: str) -> BatchBar:
        if not printing.quiet:
            console.print(name, markup=False, highlight=False)
        return BatchBar(console, quiet=printing.quiet)

    with printing.warnings():
        planned = plan(sources or (), shared, manifest, None if dataset is None else dataset.value)
        result = run_sweep(
            planned,
            spaces,
            output,
            make_engine(runs),
            SweepOptions(search.trials, search.held_out, search.max_cpu, search.seed),
            progress,
        )
    printing.show(result.to_dict, lambda: _print(result, output, standard_output()))


def _print(result: SweepResult, output: Path, console: Console) -> None:
    from rich import box
    from rich.table import Table

    from vo.cli.console import print_table
    from vo.runs.batch.sweep import BEST

    table = Table(box=box.SIMPLE_HEAD if console.is_terminal else box.ASCII2, pad_edge=False)
    for name in ("trial", "errors, ratio", "CPU time, ratio"):
        table.add_column(name, justify="right")
    table.add_column("settings")
    for trial in result.trials[:_MAX_ROWS]:
        settings = " ".join(f"{key}={value}" for key, value in trial.settings.items())
        table.add_row(str(trial.number), f"{trial.score:.3f}", f"{trial.cpu_ratio:.3f}", settings)
    print_table(console, table)
    console.print()
    if len(result.trials) > _MAX_ROWS:
        console.print(f"the best {_MAX_ROWS} of {len(result.trials)}")
    if result.best is None:
        console.print("no trial is better than the unchanged settings")
        return
    console.print(f"best       trial {result.best.number}: {output / BEST}", soft_wrap=True)
    if result.check is None:
        console.print("held out   nothing: how far this holds for other recordings is unknown")
        return
    change = next((c for c in result.check.changes if c.metric == "ate_m"), None)
    if result.check.lost or change is None:
        console.print("held out   not better: a recording is no longer finished")
        return
    verdict = "better" if change.high < 1.0 else "worse" if change.low > 1.0 else "not certain"
    console.print(
        f"held out   {verdict}: ATE {change.ratio:.3f} times that of the unchanged settings "
        f"(95 %: {change.low:.3f} to {change.high:.3f}, {change.recordings} recordings)",
        highlight=False,
        soft_wrap=True,
    )
