"""Frames without a pose, with the reasons: every frame has a pose or is listed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vo.base.failures import FailureReason, ImageDefect, describe
from vo.base.types import Ints, Skipped, State
from vo.outputs.results.run_statistics import RunStatistics

_SKIPPED, _UNTRACKED = "skipped", "untracked"


class FrameRange(NamedTuple):
    """Consecutive frames without a pose, with the reason of the last of them."""

    first: int  # number of the first frame
    last: int  # number of the last frame
    frames: int  # number of frames
    state: str  # of the odometry, or `skipped`, or `untracked`
    reason: str
    defect: ImageDefect | None = None  # of their images, None without one


def ranges_without_pose(
    statistics: RunStatistics, with_pose: Ints, skipped: Sequence[Skipped], untracked: Ints
) -> tuple[list[FrameRange], dict[str, int]]:
    """Consecutive frames with the same state and image defect, and the number of frames by state.

    A frame without a causal pose may have a smoothed one: the first of a monocular initial pair.

    `with_pose`: numbers of the frames that have a pose. `skipped`: frames that could not be read.
    `untracked`: numbers of the frames that `tracking.every` left out.
    """
    unreadable = {each.index: each.reason for each in skipped}
    left_out = set(untracked.tolist())
    reached = np.array(sorted({*statistics.frames, *unreadable, *left_out}), dtype=np.int64)
    missing = np.flatnonzero(~np.isin(reached, with_pose))
    single = [
        _single_frame(frame, statistics, unreadable, left_out)
        for frame in reached[missing].tolist()
    ]
    is_next = np.diff(missing, prepend=-2) == 1
    return _merged(zip(single, is_next.tolist(), strict=True)), _count_states(single)


def _single_frame(
    frame: int, statistics: RunStatistics, unreadable: Mapping[int, str], left_out: set[int]
) -> FrameRange:
    """The range of one frame."""
    if frame in left_out:
        reason = "left out by tracking.every, and not between two tracked frames"
        return FrameRange(frame, frame, 1, _UNTRACKED, reason)
    if frame in unreadable:
        return FrameRange(frame, frame, 1, _SKIPPED, unreadable[frame])
    if frame not in statistics.without_pose:
        reason = "its pose was discarded later"
        return FrameRange(frame, frame, 1, State.LOST.value, reason)
    state, failure = statistics.without_pose[frame]
    if failure is not None and failure.reason is FailureReason.REPEATED_IMAGE:
        return FrameRange(frame, frame, 1, _SKIPPED, describe(failure))
    shown = State.STARTING if state is State.STARTING else State.LOST
    defect = None if failure is None else failure.defect
    return FrameRange(frame, frame, 1, shown.value, describe(failure), defect)


def _merged(frames: Iterable[tuple[FrameRange, bool]]) -> list[FrameRange]:
    """Join ranges of single frames, each with a flag whether it follows the one before it."""
    ranges: list[FrameRange] = []
    for frame, is_next in frames:
        last = ranges[-1] if is_next else None
        if last and last.state == frame.state and last.defect is frame.defect:
            ranges[-1] = frame._replace(first=last.first, frames=last.frames + 1)
        else:
            ranges.append(frame)
    return ranges


def _count_states(frames: Sequence[FrameRange]) -> dict[str, int]:
    count = dict.fromkeys((State.STARTING.value, State.LOST.value, _SKIPPED, _UNTRACKED), 0)
    for frame in frames:
        count[frame.state] += 1
    return count
