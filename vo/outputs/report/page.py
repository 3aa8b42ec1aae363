"""Creates a report: one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from vo.base.errors import OutputError
from vo.base.files.complete_file import writing
from vo.outputs.report import sections
from vo.outputs.report.entry import Entry
from vo.outputs.report.markup import Markup, element, join
from vo.outputs.report.plots.catalogue import Plot
from vo.outputs.report.shown_paths import shown_paths
from vo.outputs.report.view import view

_ERRORS = ("error_time", "error_distance", "rpe", "drift", "uncertainty")
_DOCTYPE = "<!doctype html>"
# Forbids loading anything, even if a file name contained HTML.
# The only script is the one of this folder, known by its hash.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{}'"


def make_page(entries: Sequence[Entry], plots: Sequence[Plot]) -> str:
    """The HTML of a report."""
    is_comparison = len(entries) > 1
    names = ", ".join(entry.name for entry in entries)
    title = f"{len(entries)} runs compared" if is_comparison else "Visual odometry report"
    parts = [
        element("header", element("h1", title)),
        *(sections.run_header(entry, is_comparison) for entry in entries),
        *([sections.comparison(entries)] if is_comparison else []),
        *_paths(entries, plots),
        sections.plot_section("Errors and uncertainty", _named(plots, *_ERRORS)),
        sections.plot_section("Tracking and time", _named(plots, "inliers", "times")),
        *(_run_sections(entry, plots, is_comparison) for entry in entries),
        sections.settings(entries),
        element("section", element("h2", "Details"), *_details(entries)),
    ]
    return document(f"{title}: {names}", join(*parts))


def _paths(entries: Sequence[Entry], plots: Sequence[Plot]) -> list[Markup]:
    """A section for each recording: the 3D view, the figures that replace it, and poses."""
    groups = shown_paths(entries)
    found = []
    for number, shown in enumerate(groups, start=1):
        suffix, source = (f"_{number}", f", {shown.source}") if len(groups) > 1 else ("", "")
        flat = _named(plots, f"path{suffix}", f"path_side{suffix}")
        over_time = _named(plots, f"positions{suffix}", f"angles{suffix}")
        found.append(
            element(
                "section",
                element("h2", f"Path{source}"),
                view(shown),
                sections.figures(flat, "plots flat"),
                sections.figures(over_time),
            )
        )
    return found


def _named(plots: Sequence[Plot], *names: str) -> list[Plot]:
    return [plot for plot in plots if plot.run is None and plot.name in names]


def _run_sections(entry: Entry, plots: Sequence[Plot], is_comparison: bool) -> Markup:
    own = [plot for plot in plots if plot.run == entry.number]
    name = f", {entry.name}" if is_comparison else ""
    return join(
        sections.plot_section(f"Tracking and time{name}", own),
        sections.image_section(entry, f"Images{name}"),
        sections.dense_views(entry, f"Cloud{name}"),
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
    style, script = (
        files("vo.outputs.report").joinpath(name).read_text(encoding="utf-8")
        for name in ("page.css", "page.js")
    )
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = _POLICY.format(digest)
    head = join(
        Markup('<meta charset="utf-8">'),
        Markup('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        Markup('<meta name="color-scheme" content="light dark">'),
        Markup(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        Markup('<link rel="icon" href="data:,">'),
        element("title", title),
        element("style", Markup(style)),
    )
    code = Markup(f"<script>{script}</script>")
    page = join(element("head", head), element("body", element("main", body), code))
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
