"""Numbers of the frames of a run, and of their segments, from `poses.csv` beside its trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.files.bounded_files import read_text
from vo.base.types import Ints

_COLUMNS = ["frame", "stamp_ns", "segment"]


def frame_numbers(
    estimate: Path, stamps_ns: Ints, summary: Mapping[str, Any], frames: int
) -> Ints | None:
    """Numbers (N,) of the frames of some poses, from `poses.csv` beside the trajectory of a run.

    `stamps_ns`: (N,) stamps of its poses. `frames`: number of poses of the ground truth.

    Returns None if it is unknown, or if the ground truth may not have one pose for each frame of
    the recording: the run had another number of frames, or left some of them out.
    """
    is_whole = summary.get("start") in (None, 0) and summary.get("stride") in (None, 1)
    if not is_whole or summary.get("frames") != frames:
        return None
    found = _column(estimate, stamps_ns, 0)
    if found is None or not len(found) or found.min() < 0 or found.max() >= frames:
        return None
    return found


def segment_numbers(estimate: Path, stamps_ns: Ints) -> Ints | None:
    """Numbers (N,) of the segments of some poses, None if they are unknown.

    Merged segments have one number, and another segment may lie between them.

    `stamps_ns`: (N,) stamps of its poses.
    """
    return _column(estimate, stamps_ns, 2)


def _column(estimate: Path, stamps_ns: Ints, column: int) -> Ints | None:
    """Whole numbers (N,) of a column of `poses.csv`, None without them."""
    try:
        lines = read_text(estimate.with_name("poses.csv")).splitlines()
        rows = [line.split(",", 3) for line in lines]
        number_of = {int(row[1]): int(row[column]) for row in rows[1:]}
        if not rows or rows[0][:3] != _COLUMNS:
            return None
        return np.array([number_of[stamp] for stamp in stamps_ns.tolist()], dtype=np.int64)
    except (OSError, ValueError, IndexError, KeyError):
        return None
