"""Selection of the frames of a run that are shown as images."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.types import Bytes, Ints
from vo.outputs.report.run_folder import FrameTable

_MAX_EVENTS = 8
_MAX_LOSSES = 3
_WIDTH_PX = 320


class Event(NamedTuple):
    """An event at a frame; `row` is the row of the frame in the table."""

    row: int
    name: str


def choose_events(frames: FrameTable) -> list[Event]:
    """The first pose, losses, recoveries and a uniform subset of keyframes, in time order."""
    tracked = frames.state == "tracking"
    if not tracked.any():
        return [Event(0, "first frame")] if len(frames) else []
    found = {int(np.argmax(tracked)): "first pose"}
    change = np.flatnonzero(np.diff(tracked.astype(np.int8))) + 1
    for row in _uniform_subset(change[~tracked[change]], _MAX_LOSSES):
        found.setdefault(row, "lost")
        later = np.flatnonzero(tracked[row:])
        if len(later):
            found.setdefault(row + int(later[0]), "recovered")
    keyframes = np.array([r for r in np.flatnonzero(frames.keyframe) if r not in found], np.int64)
    for row in _uniform_subset(keyframes, _MAX_EVENTS - len(found)):
        found[row] = "keyframe"
    return [Event(row, found[row]) for row in sorted(found)]


def _uniform_subset(rows: Ints, max_count: int) -> list[int]:
    if len(rows) <= max_count:
        return [int(row) for row in rows]
    return [
        int(rows[i]) for i in np.linspace(0, len(rows) - 1, max(max_count, 0)).round().astype(int)
    ]


def shrink(image: Bytes) -> Bytes:
    """An image (H, W) reduced to the width of a thumbnail."""
    height, width = image.shape
    if width <= _WIDTH_PX:
        return image
    size = (_WIDTH_PX, max(round(height * _WIDTH_PX / width), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
