"""Frames without a pose: none is left out silently."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from vo.results.account import Account
from vo.types import Ints, Skipped, State


class FrameRange(NamedTuple):
    """Frames without a pose, one after the other, and the reason of the last of them."""

    first: int
    last: int
    frames: int
    state: str
    reason: str


def unplaced_ranges(
    account: Account, placed: Ints, skipped: Sequence[Skipped]
) -> tuple[list[FrameRange], dict[str, int]]:
    """Runs of frames in the same state, and how many frames in each state.

    A frame that had no pose when taken in may have one now: the first of a mono pair.
    """
    has_pose = set(placed.tolist())
    unreadable = {s.index: s.reason for s in skipped}
    ranges: list[FrameRange] = []
    count = {State.STARTING.value: 0, State.LOST.value: 0, "skipped": 0}
    follows = False
    for frame in sorted({*account.frames, *unreadable}):
        if frame in has_pose:
            follows = False
            continue
        state, reason = _why(account, unreadable, frame)
        count[state] += 1
        if follows and ranges[-1].state == state:
            frames = ranges[-1].frames + 1
            ranges[-1] = ranges[-1]._replace(last=frame, frames=frames, reason=reason)
        else:
            ranges.append(FrameRange(frame, frame, 1, state, reason))
        follows = True
    return ranges, count


def _why(account: Account, unreadable: Mapping[int, str], frame: int) -> tuple[str, str]:
    if frame in unreadable:
        return "skipped", unreadable[frame]
    if frame not in account.unplaced:
        return State.LOST.value, "its pose was given up later"
    state, reason = account.unplaced[frame]
    return (State.STARTING if state is State.STARTING else State.LOST).value, reason
