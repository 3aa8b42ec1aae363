"""Creates a report: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from vo.base.errors import OutputError
from vo.base.files.complete_file import writing
from vo.outputs.report import sections
from vo.outputs.report.entry import Entry
from vo.outputs.report.markup import Markup, element, join
from vo.outputs.report.plots.catalogue import Plot

_ERRORS = ("error_time", "error_distance", "rpe", "drift")
_DOCTYPE = "<!doctype html>"
# Forbids loading anything, even if a file name contained HTML.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def make_page(entries: Sequence[Entry], plots: Sequence[Plot]) -> str:
    """The HTML of a report."""
    is_comparison = len(entries) > 1
    names = ", ".join(entry.name for entry in entries)
    title = f"{len(entries)} runs compared" if is_comparison else "Visual odometry report"
    parts = [
        element("header", element("h1", title)),
        *(sections.run_header(entry, is_comparison) for entry in entries),
        *([sections.comparison(entries)] if is_comparison else []),
        sections.plot_section("Path", [plot for plot in plots if plot.name.startswith("path")]),
        sections.plot_section("Errors", _named(plots, *_ERRORS)),
        sections.plot_section("Uncertainty", _named(plots, "uncertainty")),
        sections.plot_section("Tracking and time", _named(plots, "inliers", "times")),
        *(_run_sections(entry, plots, is_comparison) for entry in entries),
        sections.settings(entries),
        element("section", element("h2", "Details"), *_details(entries)),
    ]
    return document(f"{title}: {names}", join(*parts))


def _named(plots: Sequence[Plot], *names: str) -> list[Plot]:
    return [plot for plot in plots if plot.run is None and plot.name in names]


def _run_sections(entry: Entry, plots: Sequence[Plot], is_comparison: bool) -> Markup:
    own = [plot for plot in plots if plot.run == entry.number]
    name = f", {entry.name}" if is_comparison else ""
    loops = [plot for plot in own if plot.name.startswith("loops")]
    markers = [plot for plot in own if plot.name.startswith("markers")]
    others = [plot for plot in own if plot not in (*loops, *markers)]
    return join(
        sections.plot_section(f"Loops{name}", loops),
        sections.plot_section(f"Markers{name}", markers),
        sections.plot_section(f"Tracking and time{name}", others),
        sections.image_section(entry, f"Images{name}"),
    )


def _details(entries: Sequence[Entry]) -> list[Markup]:
    each = [
        part(entry)
        for entry in entries
        for part in (
            sections.frames_without_pose,
            sections.segments,
            sections.loops,
            sections.relocalisations,
            sections.markers,
        )
    ]
    return [*each, sections.provenance(entries)]


def document(title: str, body: Markup) -> str:
    """A whole HTML page that loads nothing."""
    style = files("vo.outputs.report").joinpath("page.css").read_text(encoding="utf-8")
    head = join(
        Markup('<meta charset="utf-8">'),
        Markup('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        Markup('<meta name="color-scheme" content="light dark">'),
        Markup(f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'),
        Markup('<link rel="icon" href="data:,">'),
        element("title", title),
        element("style", Markup(style)),
    )
    page = join(element("head", head), element("body", element("main", body)))
    return f'{_DOCTYPE}\n<html lang="en">{page}</html>\n'


def _is_page(path: Path) -> bool:
    """Whether a file is an HTML page, or empty."""
    try:
        with path.open("rb") as stream:
            beginning = stream.read(len(_DOCTYPE)).decode(errors="replace").lower()
    except OSError:
        return False
    return not beginning or beginning == _DOCTYPE


def write_page(path: Path, page: str) -> None:
    """Write a report.

    Raises:
        OutputError: the file cannot be written, or exists and is not an HTML page.
    """
    if path.is_file() and not _is_page(path):
        raise OutputError(f"{path} is not a report and would be replaced; choose another file")
    with writing(f"report {path}", "choose another file"):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Names may contain bytes that are not UTF-8.
        path.write_text(page, encoding="utf-8", errors="replace")


def write_plots(folder: Path, plots: Sequence[Plot]) -> list[Path]:
    """Write each figure as PNG and PDF; the files.

    Raises:
        OutputError: a file cannot be written.
    """
    from vo.outputs.report.plots.style import drawing

    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with drawing():
            for plot in plots:
                for suffix in (".png", ".pdf"):
                    path = folder / f"{plot.name}{suffix}"
                    plot.figure.savefig(path, dpi=200)
                    written.append(path)
    except OSError as error:
        raise OutputError(
            f"plots cannot be written to {folder}: {error.strerror or error}; choose another folder"
        ) from error
    return written
