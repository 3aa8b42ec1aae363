"""`vo report`: HTML report of one or several runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.printable import counted
from vo.cli import options
from vo.cli.blocks import argument, option
from vo.cli.echo import echo

if TYPE_CHECKING:
    pass


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
    from vo.api.report_entries import read_entries
    from vo.base.extras import require
    from vo.outputs.report.page import make_page, write_page, write_plots
    from vo.outputs.report.plots.catalogue import draw_all
    from vo.outputs.results.output_paths import refuse_to_overwrite

    require("matplotlib", extra="report", what="reports")
    page = output or (runs[0] if len(runs) == 1 else Path()) / "report.html"
    with printing.warnings():
        entries = read_entries(runs, truth, images)
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
