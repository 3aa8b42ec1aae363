"""MCAP files as recordings: messages of ROS 1, ROS 2 and Foxglove."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vo.sources.logs.opening import open_log
from vo.sources.mcap.file import McapFile
from vo.sources.source import Source
from vo.types import Mode


def open_mcap(
    path: Path, calibration: Path | None, mode: Mode, topics: Sequence[str] = ()
) -> Source:
    """Open an MCAP file.

    Args:
        path: the file.
        calibration: file that overrides what the log says.
        mode: as in `open_source`.
        topics: `left=/a`, `right=/b` or a name alone; by default found out.

    Raises:
        SourceError: it is no MCAP file, holds no images, or it cannot be told which.
        CalibrationError: the calibration is missing or cannot be true.
    """
    return open_log(McapFile(path), "mcap", calibration, mode, topics)
