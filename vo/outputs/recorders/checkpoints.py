"""When to write an export again during a run, so that a killed process leaves a recent one."""

from __future__ import annotations

import time

_MIN_S = 1.0  # between the end of one and the begin of the next
_MAX_RATIO = 1.0 / 30.0  # of the time that they may take


class Checkpoints:
    """Times of checkpoints: often at first, more seldom as they take longer."""

    def __init__(self) -> None:
        self._ended = time.monotonic()
        self._took_s = 0.0
        self._began = self._ended

    @property
    def is_due(self) -> bool:
        """Whether one is to be written now."""
        return time.monotonic() - self._ended >= max(_MIN_S, self._took_s / _MAX_RATIO)

    def begin(self) -> None:
        """Before one is written."""
        self._began = time.monotonic()

    def end(self) -> None:
        """After one was written."""
        self._ended = time.monotonic()
        self._took_s = self._ended - self._began
