"""Recordings of which a command needs the left images only."""

from __future__ import annotations

from pathlib import Path

from vo.base.errors import CalibrationError
from vo.cli.options import Reading
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.source import Recording
from vo.recordings.sources.uncalibrated import open_uncalibrated


def open_one_camera(path: str | Path, reading: Reading) -> tuple[Recording, bool]:
    """The left images of a recording, and whether their calibration is known.

    Raises:
        VoError: it cannot be opened, or a calibration that was given cannot be used.
    """
    format, topics = reading.format, reading.topics
    try:
        found = open_source(
            path, format=format, calibration=reading.calibration, topics=topics, mode="mono"
        )
    except CalibrationError:
        if reading.calibration is not None:
            raise
        return open_uncalibrated(path, format=format, topics=topics, mode="mono"), False
    return found, True
