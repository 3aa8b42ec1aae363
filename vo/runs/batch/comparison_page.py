"""One HTML page about two batches."""

from __future__ import annotations

from collections.abc import Sequence

from vo.outputs.report.markup import Markup, element, join
from vo.outputs.report.page import document
from vo.runs.batch.comparison import METRICS, Comparison, Row

NAMES = {
    "ate_m": "ATE",
    "causal_ate_m": "causal ATE",
    "tracked_ratio": "tracked",
    "cpu_s": "CPU time",
}


def comparison_page(compared: Comparison, before: str, after: str) -> str:
    """The HTML: changes over all recordings, then each of them, worst first."""
    changes = [
        (
            NAMES[change.metric],
            f"{change.ratio:.3f}",
            f"{change.low:.3f} to {change.high:.3f}",
            str(change.recordings),
        )
        for change in compared.changes
    ]
    heading = ("metric", "ratio", "with 95 % confidence", "recordings")
    rows = [_cells(row) for row in compared.rows]
    columns = ("recording", "before", "after", *(NAMES[metric] for metric in METRICS))
    lost = f"No longer finished: {', '.join(compared.lost)}." if compared.lost else ""
    return document(
        "Comparison of batches",
        join(
            element("header", element("h1", "Comparison of batches")),
            element(
                "section",
                element("h2", "All together"),
                element("p", f"{after} by {before}; ratios above 1 are worse. {lost}"),
                _table(heading, changes),
            ),
            element("section", element("h2", "Recordings, worst first"), _table(columns, rows)),
        ),
    )


def _cells(row: Row) -> tuple[str, ...]:
    results = ("–" if each is None else each.status.value for each in (row.before, row.after))
    ratios = (f"{row.ratios[m]:.3f}" if m in row.ratios else "–" for m in METRICS)
    return (row.name, *results, *ratios)


def _table(heading: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Markup:
    head = element("tr", *(element("th", text, scope="col") for text in heading))
    body = [
        element("tr", element("th", first, scope="row"), *(element("td", each) for each in rest))
        for first, *rest in rows
    ]
    table = element("table", element("thead", head), element("tbody", *body))
    return element("div", table, class_="scroll")
