"""`vo batch`: visual odometry on many recordings."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vo.cli import options
from vo.cli.blocks import Only, block, option
from vo.cli.echo import echo
from vo.cli.flags import known_flags

if TYPE_CHECKING:
    from vo.runs.batch.batch import BatchResult, Engine

# Heading of options in `--help`, besides those in `options`.
_ENGINE = "Where and how they run"
_SOME_FAILED = 4  # exit status

Sources = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="SOURCES",
        help="Recordings, folders of recordings, quoted patterns, or URLs such as s3://bucket/logs/.",
        show_default=False,
    ),
]
Manifest = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="CSV or JSON file with a recording in each row: source, and any of name, calibration, "
        "mode, config, set, format, topics, start, end, stride, truth; other columns are tags.",
        rich_help_panel=options.INPUT,
    ),
]


class DatasetChoice(StrEnum):
    """Choices of `--dataset`: the keys of `vo.runs.batch.datasets.DATASETS`."""

    EUROC = "euroc"
    KITTI = "kitti"
    TUM = "tum"
    TUMVI = "tumvi"
    FOUR_SEASONS = "4seasons"
    HILTI = "hilti"


Dataset = Annotated[
    DatasetChoice | None,
    typer.Option(
        help="SOURCES are folders of this public data set: its sequences, calibration, ground "
        "truth, and the table that papers print.",
        show_default=False,
        rich_help_panel=options.INPUT,
    ),
]


@block(_ENGINE)
class RunOn:
    """Where and how the recordings run."""

    jobs: int | None = option(
        "Recordings at the same time on this machine.",
        default=None,
        min=1,
        metavar="N",
        show_default="one for two cores",
    )
    ray: str | None = option(
        "Run on a Ray cluster: auto (that of this machine), HOST:PORT, or local.",
        default=None,
        metavar="ADDRESS",
    )
    threads: int | None = option(
        "With --ray: cores for each recording.",
        default=None,
        min=1,
        metavar="N",
        show_default="2",
    )
    timeout: float | None = option(
        "End a run that takes longer.",
        default=None,
        min=0.1,
        metavar="SECONDS",
        show_default="never",
    )
    memory: int | None = option(
        "Address space of a run; one that needs more fails.",
        default=None,
        min=256,
        metavar="MB",
        show_default="no limit",
    )
    retries: int = option(
        "Further attempts after a crash or a timeout.", default=1, min=0, metavar="N"
    )


def batch_command(
    *,
    sources: Sources = None,
    output: Path = option(
        "Folder for the results, one folder inside for each recording.",
        "--output",
        "-o",
        default=Path("batch"),
        metavar="FOLDER",
        panel=options.OUTPUT,
    ),
    manifest: Manifest = None,
    dataset: Dataset = None,
    reading: Annotated[options.Reading, Only("calibration", "mode", "format")],
    config: options.Config = "default",
    overrides: options.Overrides = None,
    runs: RunOn,
    report: bool = option(
        "Write a report.html for each recording too, linked from index.html.",
        "--report",
        default=False,
        panel=options.OUTPUT,
    ),
    printing: options.Printing,
) -> None:
    """Run the odometry on many recordings, and tabulate the results.

    Each recording runs in a process of its own and has a folder of results,
    the same as of `vo run`. One that is damaged, crashes or hangs does not
    stop the others: it is listed with its error; its log is in failed/NAME.
    Called again, the same command runs only what has no finished result of the same
    input, settings and version.

    Run on all recordings below a folder, two at a time:

      vo batch recordings/ -o results/ --jobs 2

    Run on those of a table, with a limit of ten minutes each:

      vo batch --manifest drives.csv -o results/ --timeout 600

    Run on a public data set, as it is unpacked, and print the table of papers:

      vo batch --dataset euroc EuRoC/ -o results/

    Run on a Ray cluster, from an object store (docs/batch.md):

      vo batch s3://bucket/drives/ -o /shared/results --ray auto

    Exit status: 0 all done, 1 error, 2 wrong usage, 4 some recordings failed
    (batch.json lists them), 130 stopped by Ctrl-C; results until then are
    kept.
    """
    from vo.base.config import load_config
    from vo.base.extras import require
    from vo.cli.batch_table import BatchBar, print_batch
    from vo.cli.console import standard_error, standard_output
    from vo.runs.batch.batch import run_batch
    from vo.runs.batch.job import Job
    from vo.runs.batch.planning import MANIFEST_SUFFIXES, plan

    if report:
        require("matplotlib", extra="report", what="reports")
    given = list(sources or ())
    if manifest is None and len(given) == 1 and given[0].lower().endswith(MANIFEST_SUFFIXES[:1]):
        manifest, given = Path(given[0]), []
    if not given and manifest is None:
        raise typer.BadParameter("give recordings, folders or URLs, or a --manifest")
    if dataset is not None and manifest is not None:
        raise typer.BadParameter("--dataset finds the recordings in its folders; leave out either")
    load_config(config, overrides or ())  # a wrong setting is one error, not one for each run
    shared = Job(
        "",
        "",
        config,
        tuple(overrides or ()),
        reading.mode.value,
        None if reading.calibration is None else str(reading.calibration),
        reading.format,
    )
    with printing.warnings():
        planned = plan(given, shared, manifest, None if dataset is None else dataset.value)
        engine = make_engine(runs, report=report)
        bar = BatchBar(standard_error(), quiet=printing.quiet)
        result = run_batch(planned, output, engine, bar)
    printing.show(lambda: _as_dict(result), lambda: print_batch(result, planned, standard_output()))
    if result.is_interrupted:
        raise typer.Exit(130)
    if result.unfinished:
        if printing.quiet or printing.json_output:
            echo(f"warning: {len(result.unfinished)} recordings failed; see {output}", err=True)
        raise typer.Exit(_SOME_FAILED)


def make_engine(runs: RunOn, *, report: bool = False) -> Engine:
    """Where recordings run: on this machine, or on a cluster."""
    from vo.runs.batch.execution import Limits

    threads = runs.threads or 2
    limits = Limits(threads, runs.timeout, runs.memory, runs.retries, report, known_flags())
    if runs.ray is None:
        if runs.threads is not None:
            raise typer.BadParameter("--threads needs --ray; on this machine --jobs decides")
        from vo.runs.batch.batch import LocalEngine

        return LocalEngine(runs.jobs, limits)
    if runs.jobs is not None:
        raise typer.BadParameter("--jobs is for this machine; Ray decides by cores (--threads)")
    from vo.runs.batch.cluster import RayEngine

    return RayEngine(runs.ray, limits)


def _as_dict(result: BatchResult) -> dict[str, object]:
    from dataclasses import asdict

    from vo.runs.batch.tables import totals

    return {
        "output": str(result.output),
        "totals": asdict(totals(result.results)),
        "kept": result.kept,
        "wall_s": round(result.wall_s, 3),
        "interrupted": result.is_interrupted,
        "results": [each.to_dict() for each in result.results],
    }
