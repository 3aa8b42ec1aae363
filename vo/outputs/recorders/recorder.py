"""Interface of recorders, and a recorder that records nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple, Protocol

from vo.base.records.closed_loops import ClosedLoop, Relocalisation
from vo.base.records.metric_scale import MetricScale
from vo.base.records.seen_markers import SeenMarkers
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Rig, Trajectory

ImageChoice = Literal["full", "half", "none"]
TakeSnapshot = Callable[[], Snapshot]


class LoopClosures(NamedTuple):
    """Loops of a run, and its path before them."""

    loops: tuple[ClosedLoop, ...]
    # all segments whose place in an older world was found
    relocalisations: tuple[Relocalisation, ...]
    odometry: Trajectory  # the path before any loop, each segment in its own frame
    # number of the world of each segment that was connected to another one
    worlds: Mapping[int, int]
    # length in the world of one unit of odometry, by frame number of each keyframe
    scales: Mapping[int, float]


class Findings(NamedTuple):
    """What is known at the end of a run only."""

    scales: Mapping[int, MetricScale] = MappingProxyType({})  # by segment
    closures: LoopClosures | None = None  # None if no loop was closed
    markers: SeenMarkers | None = None  # None without markers


NO_FINDINGS = Findings()


class Recorder(Protocol):
    """Observer of a run, which it never changes.

    Any keyframe, old ones too, may get a new pose at any time: `Estimate.keyframes` contains those
    that were added or moved.
    """

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Before the first frame."""

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """After each frame; `snapshot` takes time and can only be called before this returns."""

    def flush(self) -> None:
        """While no frame comes: write what waits in memory, to survive a killed process."""

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """After the last frame, also of an interrupted run; closes.

        `causal`, `smoothed`: both complete paths, in units of the map.
        """


class NullRecorder:
    """Records nothing."""

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Do nothing."""

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Do nothing."""

    def flush(self) -> None:
        """Do nothing."""

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """Do nothing."""
