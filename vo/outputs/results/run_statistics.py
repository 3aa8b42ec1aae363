"""Statistics of a run, updated frame by frame."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.geometry.quantiles import median, percentiles
from vo.base.types import Estimate, State
from vo.outputs.results.fault_log import FaultLog


class MissingPose(NamedTuple):
    """Why a frame had no causal pose."""

    state: State
    failure: Failure | None


class StageTime(NamedTuple):
    """Wall time of a stage over the frames in which it ran."""

    median_ms: float
    p95_ms: float


class RunStatistics:
    """Statistics over the processed frames.

    `frames`: numbers of the processed frames, in time order. `without_pose`: frames without a
    causal pose, by number. `landmarks`: number of landmarks that have been in the map so far.
    """

    def __init__(self) -> None:
        self.frames = array("q")
        self.without_pose: dict[int, MissingPose] = {}
        self.landmarks = 0
        self.faults = FaultLog()
        self._highest_landmark = -1
        self._inliers = array("i")
        self._disparities_px = array("f")
        self._delays_ms = array("f")
        self._stage_ms: dict[str, array[float]] = {}

    def add(self, estimate: Estimate) -> None:
        """Add a frame."""
        self.frames.append(estimate.frame_index)
        if estimate.tracked_anew_from is not None:
            self.faults.withdraw_from(estimate.tracked_anew_from)
        self.faults.add(estimate.faults, estimate.frame_index)
        if estimate.world_from_cam0 is None:
            self.without_pose[estimate.frame_index] = MissingPose(estimate.state, estimate.failure)
        else:
            self._inliers.append(estimate.inliers)
            if estimate.median_disparity_px is not None:
                self._disparities_px.append(estimate.median_disparity_px)
        if estimate.landmark_ids is not None:
            self._count_landmarks(estimate.landmark_ids)

    def main_failure(self) -> Failure | None:
        """The newest failure with the most frequent reason, None without one."""
        failures = [each.failure for each in self.without_pose.values() if each.failure is not None]
        causes = [f for f in failures if f.reason is not FailureReason.REFERENCE_FRAME]
        if not causes:
            return failures[-1] if failures else None
        (reason, _), *_ = Counter(failure.reason for failure in causes).most_common(1)
        return next(failure for failure in reversed(causes) if failure.reason is reason)

    def add_times(self, stage_ms: Mapping[str, float]) -> None:
        """Add the wall time by stage of one frame."""
        for stage, spent in stage_ms.items():
            self._stage_ms.setdefault(stage, array("f")).append(spent)

    def add_delay(self, delay_ms: float) -> None:
        """Add the time from the capture of a live image to its pose."""
        self._delays_ms.append(delay_ms)

    @property
    def delays_ms(self) -> Sequence[float]:
        """Delays of all frames; empty unless the source is live."""
        return self._delays_ms

    @property
    def median_inliers(self) -> float | None:
        """Median over the tracked frames; None without a tracked frame."""
        return median(self._inliers) if self._inliers else None

    @property
    def median_disparity_px(self) -> float | None:
        """Median over the tracked frames of each frame's median; None without disparities."""
        return median(self._disparities_px) if self._disparities_px else None

    def stages(self) -> dict[str, StageTime]:
        """Median and 95th percentile of each stage."""
        return {
            stage: StageTime(*percentiles(spent, (50, 95)))
            for stage, spent in self._stage_ms.items()
        }

    def total_ms(self) -> dict[str, float]:
        """Total wall time of each stage."""
        return {stage: float(sum(spent)) for stage, spent in self._stage_ms.items()}

    def _count_landmarks(self, ids: np.ndarray) -> None:
        """Count new landmarks: ids increase, so those above the highest so far are new."""
        self.landmarks += int(np.count_nonzero(ids > self._highest_landmark))
        self._highest_landmark = max(self._highest_landmark, int(ids.max(initial=-1)))
