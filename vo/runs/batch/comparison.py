"""Two batches of the same recordings: what became better or worse, with confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vo.base.errors import EvaluationError
from vo.base.types import Floats
from vo.runs.batch.job import JobResult

METRICS = ("ate_m", "causal_ate_m", "tracked_ratio", "cpu_s")
_MORE_IS_BETTER = frozenset({"tracked_ratio"})
_RESAMPLES = 10_000
_CONFIDENCE = 0.95


@dataclass(frozen=True)
class Row:
    """A recording in both batches, None where it is missing.

    Ratios are second to first, of `tracked_ratio` first to second: above 1 is worse.
    """

    name: str
    before: JobResult | None
    after: JobResult | None
    ratios: Mapping[str, float]

    @property
    def is_lost(self) -> bool:
        """Whether only the first batch has a finished result."""
        return _is_done(self.before) and not _is_done(self.after)

    @property
    def worst(self) -> float:
        """The greatest ratio, CPU time left out; infinite if the recording is lost."""
        ratios = [ratio for metric, ratio in self.ratios.items() if metric != "cpu_s"]
        return math.inf if self.is_lost else max(ratios, default=1.0)


@dataclass(frozen=True)
class Change:
    """Geometric mean of the ratios of a metric over all recordings that both batches finished.

    The interval has 95 % confidence, by bootstrap.
    """

    metric: str
    recordings: int
    ratio: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """Rows, worst first, and the changes over all of them, without metrics of no recording."""

    rows: tuple[Row, ...]
    changes: tuple[Change, ...]

    @property
    def lost(self) -> tuple[str, ...]:
        """Recordings that only the first batch finished."""
        return tuple(row.name for row in self.rows if row.is_lost)

    def worse_than(self, limit: float) -> tuple[Change, ...]:
        """Metrics that are certainly worse, and by more than a ratio such as 0.05.

        CPU time is left out: it differs between machines.
        """
        return tuple(
            change
            for change in self.changes
            if change.metric != "cpu_s" and change.low > 1.0 and change.ratio > 1.0 + limit
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "changes": [asdict(change) for change in self.changes],
            "lost": list(self.lost),
            "rows": [
                {
                    "name": row.name,
                    "before": None if row.before is None else row.before.status.value,
                    "after": None if row.after is None else row.after.status.value,
                    "ratios": dict(row.ratios),
                }
                for row in self.rows
            ],
        }


def compare(before: Sequence[JobResult], after: Sequence[JobResult]) -> Comparison:
    """Compare two batches by the names of their recordings.

    Raises:
        EvaluationError: they have no recording in common.
    """
    first = {result.name: result for result in before}
    second = {result.name: result for result in after}
    if not first.keys() & second.keys():
        raise EvaluationError(
            "the batches have no recording in common; compare batches of the same recordings"
        )
    names = list(dict.fromkeys([*first, *second]))
    rows = [_row(name, first.get(name), second.get(name)) for name in names]
    changes = []
    for metric in METRICS:
        ratios = [row.ratios[metric] for row in rows if metric in row.ratios]
        if ratios:
            changes.append(_change(metric, ratios))
    return Comparison(tuple(sorted(rows, key=lambda r: (-r.worst, r.name))), tuple(changes))


def _is_done(result: JobResult | None) -> bool:
    return result is not None and result.is_done


def _row(name: str, before: JobResult | None, after: JobResult | None) -> Row:
    ratios: dict[str, float] = {}
    if before is not None and after is not None and before.is_done and after.is_done:
        for metric in METRICS:
            old, new = getattr(before, metric), getattr(after, metric)
            if metric in _MORE_IS_BETTER:
                old, new = new, old
            if old is not None and new is not None and old > 0.0 and new > 0.0:
                ratios[metric] = new / old
    return Row(name, before, after, ratios)


def _change(metric: str, ratios: Sequence[float]) -> Change:
    """Geometric mean with a percentile bootstrap (Efron and Tibshirani 1993, chapter 13)."""
    logs: Floats = np.log(np.asarray(ratios))
    rng = np.random.default_rng(0)
    means = np.empty(_RESAMPLES)
    for start in range(0, _RESAMPLES, 100):  # in parts, for thousands of recordings
        drawn = rng.integers(0, len(logs), (100, len(logs)))
        means[start : start + 100] = logs[drawn].mean(axis=1)
    tail = 50.0 * (1.0 - _CONFIDENCE)
    low, high = np.percentile(means, [tail, 100.0 - tail])
    return Change(
        metric, len(logs), *(math.exp(float(value)) for value in (logs.mean(), low, high))
    )
