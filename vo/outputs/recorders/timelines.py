"""The two timelines of a recording: frame number and sensor time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from vo.outputs.recorders import entities

_EARLIEST_EPOCH_NS = 10**17  # March 1973: smaller stamps are not relative to the Unix epoch


class Moment(NamedTuple):
    """Number and time of a frame."""

    frame_index: int
    stamp_ns: int


class Timelines:
    """Converts moments to columns; the first one decides whether stamps are Unix times."""

    def __init__(self) -> None:
        self._is_unix_time: bool | None = None

    def columns(self, moments: Sequence[Moment]) -> list[rr.TimeColumn]:
        """Columns of both timelines for rows at these moments."""
        frames = np.array([moment.frame_index for moment in moments], dtype=np.int64)
        stamps = np.array([moment.stamp_ns for moment in moments], dtype=np.int64)
        if self._is_unix_time is None:
            self._is_unix_time = bool(stamps[0] >= _EARLIEST_EPOCH_NS)
        name = entities.SENSOR_TIMELINE
        if self._is_unix_time:
            sensor = rr.TimeColumn(name, timestamp=stamps.astype("datetime64[ns]"))
        else:
            sensor = rr.TimeColumn(name, duration=stamps.astype("timedelta64[ns]"))
        return [rr.TimeColumn(entities.FRAME_TIMELINE, sequence=frames), sensor]
