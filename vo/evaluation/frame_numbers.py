"""Numbers of the frames of a run, to pair its poses with ground truth that has no stamps."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vo.bounded_files import read_text
from vo.types import Ints

_COLUMNS = ["frame", "stamp_ns"]


def frame_numbers(
    estimate: Path, stamps_ns: Ints, summary: Mapping[str, Any], frames: int
) -> Ints | None:
    """Numbers (N,) of the frames of some poses, from `poses.csv` beside the trajectory of a run.

    Args:
        estimate: file of the trajectory.
        stamps_ns: (N,) stamps of its poses.
        summary: the summary of the run.
        frames: number of poses of the ground truth.

    Returns:
        None if it is unknown, or if the ground truth may not have one pose for each frame of the
        recording: the run had another number of frames, or left some of them out.
    """
    is_whole = summary.get("start") in (None, 0) and summary.get("stride") in (None, 1)
    if not is_whole or summary.get("frames") != frames:
        return None
    try:
        lines = read_text(estimate.with_name("poses.csv")).splitlines()
        rows = [line.split(",", 2) for line in lines]
        number_of = {int(row[1]): int(row[0]) for row in rows[1:]}
        if not rows or rows[0][:2] != _COLUMNS:
            return None
        found = np.array([number_of[stamp] for stamp in stamps_ns.tolist()], dtype=np.int64)
    except (OSError, ValueError, IndexError, KeyError):
        return None
    return found if len(found) and found.min() >= 0 and found.max() < frames else None
