"""Interface for the progress of a run."""

from __future__ import annotations

from typing import Protocol

from vo.base.types import Estimate


class Progress(Protocol):
    """Observer of a run."""

    def begin(self, name: str, total: int) -> None:
        """Before the first frame; `total` is 0 if the number of frames is unknown."""

    def step(self, done: int, estimate: Estimate) -> None:
        """After each frame; `done` includes unreadable frames."""

    def finish(self) -> None:
        """After the last frame, also if the run is interrupted."""


class NullProgress:
    """Progress without display."""

    def begin(self, name: str, total: int) -> None:
        """Do nothing."""

    def step(self, done: int, estimate: Estimate) -> None:
        """Do nothing."""

    def finish(self) -> None:
        """Do nothing."""
