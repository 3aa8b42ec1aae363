"""The files about a whole batch: `batch.json`, `batch.csv`, `index.html`, and `table.md`."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.base.printable import spreadsheet_row
from vo.base.version import __version__
from vo.outputs.results.folder import write_atomically
from vo.runs.batch.datasets import table_of
from vo.runs.batch.job import JobResult, JobStatus
from vo.runs.batch.planning import Plan

SUMMARY, TABLE, PAGE = "batch.json", "batch.csv", "index.html"
DATASET_TABLE = "table.md"
SCHEMA_VERSION = 1
_COLUMNS = (
    *("name", "source", "status", "verdict", "trusted", "frames", "tracked_ratio", "segments"),
    *("path_m", "length_unit", "ate_m", "causal_ate_m", "drift_percent", "drift_deg_per_100m"),
    *("wall_s", "cpu_s", "frames_per_s", "peak_rss_mb", "attempts", "error", "warnings"),
)


@dataclass(frozen=True)
class Totals:
    """Figures over all recordings of a batch; None where there is nothing to count.

    Frames, times and the ratio of frames with a pose are of finished runs; `untrusted` of them are
    not to be relied on.
    """

    recordings: int
    by_status: Mapping[str, int]
    untrusted: int
    tracked_ratio: float | None
    median_ate_m: float | None
    frames: int
    wall_s: float
    cpu_s: float


def totals(results: Sequence[JobResult]) -> Totals:
    """Figures over all results."""
    done = [result for result in results if result.is_done]
    ratios = [r.tracked_ratio for r in done if r.tracked_ratio is not None]
    errors = [r.ate_m for r in done if r.ate_m is not None]
    counts = Counter(result.status.value for result in results)
    return Totals(
        len(results),
        {status.value: counts[status.value] for status in JobStatus if counts[status.value]},
        sum(result.trusted is False for result in done),
        sum(ratios) / len(ratios) if ratios else None,
        median(errors) if errors else None,
        sum(result.frames or 0 for result in done),
        round(sum(result.wall_s or 0.0 for result in done), 3),
        round(sum(result.cpu_s or 0.0 for result in done), 3),
    )


def write_tables(output: Path, results: Sequence[JobResult], plan: Plan) -> None:
    """Write all files about a batch, each of them at once.

    Raises:
        OutputError: a file cannot be written.
    """
    from vo.runs.batch.page import overview_page

    over_all = totals(results)
    values: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "vo": __version__,
        "totals": asdict(over_all),
        "renamed": dict(plan.renamed),
        "left_out": list(plan.left_out),
        "results": [result.to_dict() for result in results],
    }
    text = json.dumps(values, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(output / SUMMARY, text)
    write_atomically(output / TABLE, table_text(results))
    if plan.dataset is not None:
        write_atomically(output / DATASET_TABLE, table_of(plan.dataset, results))
    write_atomically(output / PAGE, overview_page(output, results, over_all, plan))


def table_text(results: Sequence[JobResult]) -> str:
    """The results as CSV, a row each; tags have columns of their own."""
    tags = sorted({tag for result in results for tag in result.tags})
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(spreadsheet_row([*_COLUMNS, *(f"tag:{tag}" for tag in tags)]))
    for result in results:
        values = result.to_dict()
        values["warnings"] = "; ".join(result.warnings)
        row = ["" if values[name] is None else values[name] for name in _COLUMNS]
        writer.writerow(spreadsheet_row([*row, *(result.tags.get(tag, "") for tag in tags)]))
    return stream.getvalue()


def read_batch(folder: Path) -> list[JobResult]:
    """The results of a batch from its `batch.json`.

    Raises:
        SourceError: the folder is not that of a batch, or the file is damaged.
    """
    path = folder / SUMMARY
    try:
        values = load_json(read_text(path))
        return [JobResult.from_dict(each) for each in values["results"]]
    except FileNotFoundError as error:
        raise SourceError(f"{folder} has no {SUMMARY}; use the `output` of a `vo batch`") from error
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise SourceError(
            f"{path} is not the summary of a batch; use the `output` of a `vo batch`"
        ) from error
