"""What every recorder offers, and the one that records nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

from vo.types import Estimate, Rig, Snapshot, Trajectory

ImageChoice = Literal["full", "half", "none"]
TakeSnapshot = Callable[[], Snapshot]


class Recorder(Protocol):
    """Takes in a run as it goes on; never changes it."""

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Before the first frame."""

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """After each frame; `snapshot` may be called before this returns, and takes time then."""

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """After the last frame, also of an interrupted run, with both whole paths; closes."""


class NullRecorder:
    """Records nothing."""

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Do nothing."""

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Do nothing."""

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """Do nothing."""
