"""One HTML page about a batch, with links to the results and reports of its runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from vo.outputs.report.markup import Markup, duration, element, join, length, number, percentage
from vo.outputs.report.page import document
from vo.runs.batch.execution import FAILED, LOG, REPORT
from vo.runs.batch.job import JobResult
from vo.runs.batch.planning import Plan

if TYPE_CHECKING:
    from vo.runs.batch.tables import Totals

_BAR_PX = 120


def overview_page(output: Path, results: Sequence[JobResult], totals: Totals, plan: Plan) -> str:
    """The HTML of the overview: problems first, then all recordings."""
    problems = [result for result in results if not result.is_done or result.trusted is False]
    parts = [
        element("header", element("h1", "Batch of recordings")),
        element("section", element("h2", "All together"), _facts(totals)),
    ]
    if problems:
        parts.append(element("section", element("h2", "Problems"), _problems(problems)))
    parts.append(element("section", element("h2", "Recordings"), _table(output, results)))
    if plan.renamed or plan.left_out:
        parts.append(element("section", element("h2", "Names"), _names(plan)))
    return document("Batch of recordings", join(*parts))


def _facts(totals: Totals) -> Markup:
    counts = ", ".join(f"{count} {status}" for status, count in totals.by_status.items())
    ratio, error = totals.tracked_ratio, totals.median_ate_m
    facts = [
        ("recordings", f"{totals.recordings}: {counts}"),
        ("not to be trusted", str(totals.untrusted)),
        ("frames with a pose", "–" if ratio is None else f"{100 * ratio:.1f} %"),
        ("median ATE", "–" if error is None else length(error)),
        ("frames", f"{totals.frames:,}"),
        ("time of all runs", f"{duration(totals.wall_s)}, CPU {duration(totals.cpu_s)}"),
    ]
    rows = [element("tr", element("th", k, scope="row"), element("td", v)) for k, v in facts]
    return element("div", element("table", element("tbody", *rows)), class_="scroll")


def _problems(results: Sequence[JobResult]) -> Markup:
    items = []
    for result in results:
        what = result.error or f"{result.verdict}: {'; '.join(result.warnings[:2])}"
        items.append(element("li", element("strong", result.name), f" {result.status}: {what}"))
    return element("ul", *items)


def _table(output: Path, results: Sequence[JobResult]) -> Markup:
    heading = ["recording", "result", "poses", "segments", "path", "ATE", "ATE", "causal"]
    heading += ["frames/s", "time", "warnings"]
    worst = max((r.ate_m for r in results if r.ate_m is not None), default=0.0)
    head = element("tr", *(element("th", text, scope="col") for text in heading))
    rows = [_row(output, result, worst) for result in results]
    inside = element("table", element("thead", head), element("tbody", *rows))
    return element("div", inside, class_="scroll")


def _row(output: Path, result: JobResult, worst_m: float) -> Markup:
    r = result
    tracked = "–" if r.tracked_ratio is None else percentage(r.tracked_ratio, 1.0)
    error = r.ate_m
    cells: list[str] = [
        r.verdict or r.status.value,
        tracked,
        "–" if r.segments is None else str(r.segments),
        "–" if r.path_m is None else length(r.path_m, r.length_unit or "m"),
        "–" if error is None else length(error),
        _bar(0.0 if error is None or not worst_m else error / worst_m),
        "–" if r.causal_ate_m is None else length(r.causal_ate_m),
        "–" if r.frames_per_s is None else number(r.frames_per_s),
        "–" if r.wall_s is None else duration(r.wall_s),
        str(len(r.warnings)) if r.is_done else r.error or "",
    ]
    return element(
        "tr",
        element("th", _link(output, r), scope="row"),
        *(element("td", cell) for cell in cells),
    )


def _link(output: Path, result: JobResult) -> Markup:
    """The name, as a link to the report if there is one, else to the results or the log."""
    if not result.is_done:
        log = output / FAILED / result.name / LOG
        if not log.is_file() or not log.stat().st_size:
            return element("span", result.name)
        return element("a", result.name, href=f"{FAILED}/{quote(result.name)}/{LOG}")
    has_report = (output / result.name / REPORT).is_file()
    target = f"{quote(result.name)}/{REPORT if has_report else 'summary.json'}"
    return element("a", result.name, href=target)


def _bar(ratio: float) -> Markup:
    width = f"{ratio * _BAR_PX:.0f}px"
    style = f"display:inline-block;height:0.7em;width:{width};background:currentColor;opacity:.4"
    return element("span", style=style)


def _names(plan: Plan) -> Markup:
    items = [element("li", f"{name} is {source}") for name, source in plan.renamed.items()]
    items += [element("li", f"{path} has no recording") for path in plan.left_out]
    return element("ul", *items)
