"""MCAP files as recordings: messages of ROS 1, ROS 2 and Foxglove."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vo.sources.logs.choice import choose_topics
from vo.sources.logs.opening import open_log
from vo.sources.mcap.file import McapFile
from vo.sources.mcap.follow import Arrivals, GrowingFile
from vo.sources.source import Recording
from vo.types import Mode


def open_mcap(
    path: Path,
    calibration: Path | None,
    mode: Mode,
    topics: Sequence[str] = (),
    follow: bool = False,
) -> Recording:
    """Open an MCAP file.

    Args:
        path: the file.
        calibration: file that overrides what the log says.
        mode: as in `open_source`.
        topics: `left=/a`, `right=/b` or a name alone; by default found out.
        follow: whether it is still being written: frames are handed out as they come, until the
            file is closed or has not grown for a while.

    Raises:
        SourceError: it is no MCAP file, holds no images, or it cannot be told which.
        CalibrationError: the calibration is missing or cannot be true.
    """
    if not follow:
        return open_log(McapFile(path), "mcap", calibration, mode, topics)
    growing = GrowingFile(path)
    file = growing.wait_for_cameras()
    source = open_log(file, "mcap", calibration, mode, topics)
    choice = choose_topics(file.topics, topics, mode)
    right = choice.right if source.rig.is_stereo else None
    source.begin_anew(Arrivals(growing, file, choice.left, right).next_frames)
    return source
