"""Frames without a pose: none is left out silently."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vo.failures import ImageDefect, describe
from vo.results.account import Account
from vo.types import Ints, Skipped, State

_LEFT_OUT = ("untracked", "left out by tracking.every, and not between two tracked frames", None)


class FrameRange(NamedTuple):
    """Consecutive frames without a pose, with the reason of the last of them.

    Attributes:
        first: number of the first frame.
        last: number of the last frame.
        frames: how many there are.
        state: of the odometry, or `skipped`, or `untracked`.
        reason: of the last of them, for people.
        defect: of their images, None without one.
    """

    first: int
    last: int
    frames: int
    state: str
    reason: str
    defect: ImageDefect | None = None


def unplaced_ranges(
    account: Account, placed: Ints, skipped: Sequence[Skipped], untracked: Ints
) -> tuple[list[FrameRange], dict[str, int]]:
    """Runs of frames in the same state and light, and how many frames in each state.

    A frame that had no pose when taken in may have one now: the first of a mono pair.

    Args:
        account: books of the run.
        placed: numbers of the frames that have a pose.
        skipped: frames that could not be read.
        untracked: numbers of frames that were left out on purpose.
    """
    unreadable = {s.index: s.reason for s in skipped}
    left_out = set(untracked.tolist())
    reached = np.array(sorted({*account.frames, *unreadable, *left_out}), dtype=np.int64)
    missing = np.flatnonzero(~np.isin(reached, placed))
    follows = np.diff(missing, prepend=-2) == 1
    ranges: list[FrameRange] = []
    count = {State.STARTING.value: 0, State.LOST.value: 0, "skipped": 0, "untracked": 0}
    for frame, after in zip(reached[missing].tolist(), follows, strict=True):
        state, reason, defect = _LEFT_OUT if frame in left_out else _why(account, unreadable, frame)
        count[state] += 1
        before = ranges[-1] if after else None
        if before and before.state == state and before.defect is defect:
            ranges[-1] = before._replace(last=frame, frames=before.frames + 1, reason=reason)
        else:
            ranges.append(FrameRange(frame, frame, 1, state, reason, defect))
    return ranges, count


def _why(
    account: Account, unreadable: Mapping[int, str], frame: int
) -> tuple[str, str, ImageDefect | None]:
    if frame in unreadable:
        return "skipped", unreadable[frame], None
    if frame not in account.unplaced:
        return State.LOST.value, "its pose was given up later", None
    state, failure = account.unplaced[frame]
    kind = State.STARTING if state is State.STARTING else State.LOST
    defect = None if failure is None else failure.defect
    return kind.value, describe(failure), defect
