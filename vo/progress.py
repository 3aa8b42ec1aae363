"""How a run tells whoever waits for it how far it is."""

from __future__ import annotations

from typing import Protocol

from vo.types import Estimate


class Progress(Protocol):
    """Watches a run; never changes it."""

    def begin(self, name: str, total: int) -> None:
        """Before the first frame.

        Args:
            name: of the recording.
            total: number of frames that were asked for.
        """

    def step(self, done: int, estimate: Estimate) -> None:
        """After each frame; `done` also counts those that could not be read."""

    def finish(self) -> None:
        """After the last frame, also of an interrupted run."""


class NullProgress:
    """Watches nothing."""

    def begin(self, name: str, total: int) -> None:
        """Do nothing."""

    def step(self, done: int, estimate: Estimate) -> None:
        """Do nothing."""

    def finish(self) -> None:
        """Do nothing."""
