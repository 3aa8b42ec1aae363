"""What is counted while a run goes on, frame by frame."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vo.failures import Failure
from vo.geometry.quantiles import median, percentiles
from vo.types import Estimate, State


class Unplaced(NamedTuple):
    """Why a frame had no pose when it was taken in."""

    state: State
    failure: Failure | None


class StageTime(NamedTuple):
    """Wall time of a stage over the frames in which it ran."""

    median_ms: float
    p95_ms: float


class Account:
    """Books of a run; every frame that was taken in stands in them once.

    Attributes:
        frames: numbers of the frames taken in, in time order.
        unplaced: those without a causal pose, and why.
        landmarks: how many landmarks the map has held so far.
    """

    def __init__(self) -> None:
        self.frames = array("q")
        self.unplaced: dict[int, Unplaced] = {}
        self.landmarks = 0
        self._highest_landmark = -1
        self._inliers = array("i")
        self._disparities_px = array("f")
        self._stage_ms: dict[str, array[float]] = {}

    def note(self, estimate: Estimate) -> None:
        """Enter a frame."""
        self.frames.append(estimate.frame_index)
        if estimate.world_from_cam0 is None:
            self.unplaced[estimate.frame_index] = Unplaced(estimate.state, estimate.failure)
        else:
            self._inliers.append(estimate.inliers)
            if estimate.median_disparity_px is not None:
                self._disparities_px.append(estimate.median_disparity_px)
        if estimate.landmark_ids is not None:
            self._count_landmarks(estimate.landmark_ids)

    def note_time(self, stage_ms: Mapping[str, float]) -> None:
        """Enter what the stages of one frame took."""
        for stage, spent in stage_ms.items():
            self._stage_ms.setdefault(stage, array("f")).append(spent)

    @property
    def median_inliers(self) -> float | None:
        """Of the tracked frames; None if there is none."""
        return median(self._inliers) if self._inliers else None

    @property
    def median_disparity_px(self) -> float | None:
        """Median over tracked frames of the median of each; None without disparities."""
        return median(self._disparities_px) if self._disparities_px else None

    def stages(self) -> dict[str, StageTime]:
        """Median and 95th percentile of each stage."""
        return {
            stage: StageTime(*percentiles(spent, (50, 95)))
            for stage, spent in self._stage_ms.items()
        }

    def total_ms(self) -> dict[str, float]:
        """All the time of each stage."""
        return {stage: float(sum(spent)) for stage, spent in self._stage_ms.items()}

    def _count_landmarks(self, ids: np.ndarray) -> None:
        """Ids only go up, so those above the highest so far are new."""
        self.landmarks += int(np.count_nonzero(ids > self._highest_landmark))
        self._highest_landmark = max(self._highest_landmark, int(ids.max(initial=-1)))
