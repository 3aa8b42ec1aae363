"""What every recorder offers, and the one that records nothing."""

from __future__ import annotations

from typing import Literal, Protocol

from vo.types import Estimate, Rig, Trajectory

ImageChoice = Literal["full", "half", "none"]


class Recorder(Protocol):
    """Takes in a run as it goes on; never changes it."""

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Before the first frame."""

    def record(self, estimate: Estimate) -> None:
        """After each frame."""

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """After the last frame, also of an interrupted run, with both whole paths; closes."""


class NullRecorder:
    """Records nothing."""

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Do nothing."""

    def record(self, estimate: Estimate) -> None:
        """Do nothing."""

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """Do nothing."""
