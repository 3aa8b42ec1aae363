"""MCAP files as recordings: messages of ROS 1, ROS 2 and Foxglove."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vo.base.types import Mode
from vo.recordings.sources.logs.choice import choose_topics
from vo.recordings.sources.logs.opening import open_log
from vo.recordings.sources.mcap.file import McapFile
from vo.recordings.sources.mcap.follow import ArrivingFrames, GrowingFile
from vo.recordings.sources.source import Recording


def open_mcap(
    path: Path,
    calibration: Path | None,
    mode: Mode,
    topics: Sequence[str] = (),
    right_offset_ns: int | None = None,
    follow: bool = False,
) -> Recording:
    """Open an MCAP file."""
    if not follow:
        return open_log(McapFile(path), "mcap", calibration, mode, topics, right_offset_ns)
    growing = GrowingFile(path)
    file = growing.wait_for_cameras()
    source = open_log(file, "mcap", calibration, mode, topics, right_offset_ns)
    choice = choose_topics(file.topics, topics, mode)
    right = choice.right if source.rig.is_stereo else None
    arriving = ArrivingFrames(growing, file, choice.left, right, source.right_offset_ns)
    source.follow(arriving.next_frames)
    return source
