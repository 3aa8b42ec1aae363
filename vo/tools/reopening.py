"""The recording of a finished run, as the run has opened it."""

from __future__ import annotations

from pathlib import Path

from vo.base.types import Mode
from vo.outputs.report.run_folder import RunRecord
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.source import Recording


def recording_of(record: RunRecord) -> Recording:
    """Open the recording of a run, which must be where it was.

    Raises:
        SourceError: it is not there, or damaged.
    """
    summary = record.summary
    mode: Mode = "mono" if summary["mode"] == "mono" else "auto"
    return open_source(
        Path(str(summary["source"])),
        format=str(summary["format"]),
        calibration=summary.get("calibration"),
        mode=mode,
        topics=summary.get("topics", ()),
        right_offset_ns=summary.get("right_offset_ns"),
    )
