"""The two timelines of a recording: number of the frame, and time of the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from vo.recording import entities

_EARLIEST_EPOCH_NS = 10**17  # March 1973: smaller stamps count from the start of something else


class Moment(NamedTuple):
    """When a frame was taken."""

    frame_index: int
    stamp_ns: int


class Timelines:
    """Turns moments into columns; the first one tells whether stamps count from the epoch."""

    def __init__(self) -> None:
        self._counts_from_epoch: bool | None = None

    def columns(self, moments: Sequence[Moment]) -> list[rr.TimeColumn]:
        """Both timelines of rows at these moments."""
        frames = np.array([moment.frame_index for moment in moments], dtype=np.int64)
        stamps = np.array([moment.stamp_ns for moment in moments], dtype=np.int64)
        if self._counts_from_epoch is None:
            self._counts_from_epoch = bool(stamps[0] >= _EARLIEST_EPOCH_NS)
        name = entities.SENSOR_TIMELINE
        if self._counts_from_epoch:
            sensor = rr.TimeColumn(name, timestamp=stamps.astype("datetime64[ns]"))
        else:
            sensor = rr.TimeColumn(name, duration=stamps.astype("timedelta64[ns]"))
        return [rr.TimeColumn(entities.FRAME_TIMELINE, sequence=frames), sensor]
