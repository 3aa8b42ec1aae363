"""`vo report`: runs as one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from vo.report.entry import Entry
    from vo.report.run_folder import RunRecord


def report_command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN", help="Folders that `vo run` wrote; several are compared."),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE", help="The HTML file; overwritten where it exists."
        ),
    ] = Path("report.html"),
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="TRUTH",
            help="Ground truth file, or a recording that has one.",
            show_default="that of the recording, if it is still there",
        ),
    ] = None,
    plots: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write each figure as PNG and PDF into this folder."),
    ] = None,
    images: Annotated[
        bool, typer.Option(help="Show small images of where something happened.")
    ] = True,
) -> None:
    """Put runs into one HTML file to look at and to send to others.

    Verdict, warnings, path against truth, errors, features, times, settings;
    the file needs no network and nothing beside it. Where the recording is
    still there, its truth and some of its images are taken from it.

      vo report out/

    Two runs of one recording compared, figures for a paper too:

      vo report out/mono out/stereo -o compared.html --plots figures/
    """
    from vo.cli.console import standard_error
    from vo.cli.progress import warnings_on
    from vo.report.page import make_page, write_page, write_plots
    from vo.report.plots.catalogue import draw_all

    with warnings_on(standard_error()):
        entries = _entries(runs, truth, images)
    figures = list(draw_all(entries))
    write_page(output, make_page(entries, figures))
    typer.echo(f"report      {output}")
    if plots is not None:
        written = write_plots(plots, figures)
        typer.echo(f"plots       {len(written)} files in {plots}")


def _entries(folders: Sequence[Path], truth: Path | None, images: bool) -> list[Entry]:
    from vo.report.entry import first_stamps, names_of
    from vo.report.run_folder import read_run

    records = [read_run(folder) for folder in folders]
    described = zip(names_of(folders), range(len(folders)), records, strict=True)
    zeros = first_stamps(records)
    return [
        _entry(name, number, run, zeros[number], truth, images) for name, number, run in described
    ]


def _entry(
    name: str, number: int, run: RunRecord, zero_ns: int, truth: Path | None, images: bool
) -> Entry:
    from vo.cli.report_sources import judge, open_recording, take_thumbnails
    from vo.report.entry import Entry

    source, why_not = open_recording(run)
    judged = judge(run, truth, source, why_not)
    return Entry(
        name,
        number,
        run,
        judged.evaluation,
        judged.truth,
        judged.origin,
        judged.notes,
        take_thumbnails(run, source, zero_ns) if images and source is not None else (),
        zero_ns,
        judged.others,
        judged.causal_ate_m,
    )
