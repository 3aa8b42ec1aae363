"""`vo report`: HTML report of one or several runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.printable import counted
from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo

if TYPE_CHECKING:
    from vo.outputs.report.entry import Entry
    from vo.outputs.report.run_folder import RunRecord


def report_command(
    runs: list[Path] = argument("Output folders of `vo run`; several are compared.", metavar="RUN"),
    *,
    output: Path | None = option(
        "HTML file to write; an earlier report is replaced.",
        "--output",
        "-o",
        default=None,
        metavar="FILE",
        show_default="report.html in the folder of the run; of several runs, in the current folder",
    ),
    truth: Path | None = option(
        "Ground truth file, or recording with ground truth.",
        default=None,
        metavar="TRUTH",
        show_default="that of the run's recording",
    ),
    picture: Path | None = option(
        "Also save each figure as PNG and PDF in this folder.", default=None, metavar="FOLDER"
    ),
    images: bool = option("Include small images of notable frames.", default=True),
    printing: options.Printing,
) -> None:
    """Write an HTML report of one or several runs.

    The page contains verdict, warnings, paths, errors, features, timing and
    settings, needs no other files and no network. Ground truth and images are
    read from the recording if it still exists.

    Report on one run:

      vo report out/

    Compare two runs, and save the figures for a paper:

      vo report out/mono out/stereo -o compared.html --picture figures/
    """
    from vo.base.extras import require
    from vo.outputs.report.page import make_page, write_page, write_plots
    from vo.outputs.report.plots.catalogue import draw_all
    from vo.outputs.results.output_paths import refuse_to_overwrite

    require("matplotlib", extra="report", what="reports")
    page = output or (runs[0] if len(runs) == 1 else Path()) / "report.html"
    with printing.warnings():
        entries = _entries(runs, truth, images)
    recordings = [Path(str(entry.run.summary["source"])) for entry in entries]
    refuse_to_overwrite([*recordings, truth], [page, picture])
    figures = list(draw_all(entries))
    write_page(page, make_page(entries, figures))
    written = [] if picture is None else write_plots(picture, figures)

    def text() -> None:
        echo(f"report      {page}")
        if picture is not None:
            echo(f"pictures    {counted(len(written), 'file')} in {picture}")

    record = {
        "report": str(page),
        "pictures": list(map(str, written)),
        "runs": list(map(str, runs)),
    }
    printing.show(lambda: record, text)


def _entries(folders: Sequence[Path], truth: Path | None, images: bool) -> list[Entry]:
    from vo.outputs.report.entry import first_stamps, names_of
    from vo.outputs.report.run_folder import read_run

    records = [read_run(folder) for folder in folders]
    described = zip(names_of(folders), range(len(folders)), records, strict=True)
    zeros = first_stamps(records)
    return [
        _entry(name, number, run, zeros[number], truth, images) for name, number, run in described
    ]


def _entry(
    name: str, number: int, run: RunRecord, zero_ns: int, truth: Path | None, images: bool
) -> Entry:
    from vo.cli.report_sources import evaluate_run, open_recording, take_thumbnails
    from vo.outputs.report.entry import Entry

    source, why_no_truth = open_recording(run)
    evaluated = evaluate_run(run, truth, source, why_no_truth)
    return Entry(
        name,
        number,
        run,
        evaluated.evaluation,
        evaluated.truth,
        evaluated.origin,
        evaluated.notes,
        take_thumbnails(run, source, zero_ns) if images and source is not None else (),
        zero_ns,
        evaluated.others,
        evaluated.causal_ate_m,
    )
