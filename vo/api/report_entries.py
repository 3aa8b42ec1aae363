"""Entries of a report: runs with their ground truth and images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vo.api.report_sources import evaluate_run, open_recording, take_thumbnails
from vo.outputs.report.entry import Entry, first_stamps, names_of
from vo.outputs.report.run_folder import RunRecord, read_run


def read_entries(folders: Sequence[Path], truth: Path | None, images: bool) -> list[Entry]:
    """Everything that a report says of runs: their folders, recordings and ground truth."""
    records = [read_run(folder) for folder in folders]
    described = zip(names_of(folders), range(len(folders)), records, strict=True)
    zeros = first_stamps(records)
    return [
        _entry(name, number, run, zeros[number], truth, images) for name, number, run in described
    ]


def _entry(
    name: str, number: int, run: RunRecord, zero_ns: int, truth: Path | None, images: bool
) -> Entry:
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
