"""Statistics of a run, updated frame by frame: faults by kind, frames without a pose, wall time."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vo.base.failures import Failure, FailureReason, ImageDefect, describe
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.quantiles import median, percentiles
from vo.base.types import Estimate, Ints, Skipped, State

# Found by tracking, and not in the images alone.
_OF_TRACKING = (
    FaultKind.TWO_MOTIONS,
    FaultKind.BENT_MAP,
    FaultKind.IMPLAUSIBLE_STEP,
    FaultKind.WRONG_STEREO_CALIBRATION,
    FaultKind.WRONG_LENS,
)
# Implausible steps from which those that were not noticed are probable, too, as where rows of
# images are missing: so many, and at least one in so many frames.
_MIN_STEPS, _STEP_EVERY = 3, 100

_OF_CAMERAS = FaultKind.CAMERA_LEFT_OUT


class FaultRecord(NamedTuple):
    """All faults of one kind in a run."""

    kind: FaultKind
    is_handled: bool  # whether all of them were handled, see `Fault`
    frames: int  # number of frames with it; 0 for a fault of the whole recording
    first: int | None  # number of the first frame with it, None for a fault of the whole recording
    last: int | None  # number of the last frame with it, or None
    value: float  # of the largest magnitude, in the unit of its message
    place: str = ""  # where the one of this value lies in the image, or all cameras; or empty


class FaultLog:
    """Collects faults; its size does not depend on the length of a run."""

    def __init__(self) -> None:
        self._records: dict[FaultKind, FaultRecord] = {}

    def add(self, faults: Iterable[Fault], frame: int | None = None) -> None:
        """Add the faults of a frame, or those of the whole recording."""
        for fault in faults:
            before = self._records.get(fault.kind)
            count = 0 if frame is None else 1
            record = FaultRecord(
                fault.kind, fault.is_handled, count, frame, frame, fault.value, fault.place
            )
            self._records[fault.kind] = record if before is None else _joined(before, record)

    def withdraw_from(self, frame: int) -> None:
        """Remove what tracking has found from a frame on, which has been tracked anew."""
        for kind in _OF_TRACKING:
            record = self._records.get(kind)
            if record is not None and record.first is not None and record.first >= frame:
                del self._records[kind]

    def records(self) -> tuple[FaultRecord, ...]:
        """One record for each kind, in the order of `FaultKind`."""
        return tuple(self._records[kind] for kind in FaultKind if kind in self._records)


def _joined(before: FaultRecord, new: FaultRecord) -> FaultRecord:
    larger = max(before, new, key=lambda record: abs(record.value))
    joined = FaultRecord(
        before.kind,
        before.is_handled and new.is_handled,
        before.frames + new.frames,
        new.first if before.first is None else before.first,
        before.last if new.last is None else new.last,
        larger.value,
        _both(before.place, new.place) if before.kind is _OF_CAMERAS else larger.place,
    )
    are_steps = joined.kind is FaultKind.IMPLAUSIBLE_STEP and joined.frames >= _MIN_STEPS
    if not are_steps or joined.first is None or joined.last is None:
        return joined
    is_rare = joined.last - joined.first > _STEP_EVERY * joined.frames
    return joined._replace(is_handled=joined.is_handled and is_rare)


def _both(cameras: str, others: str) -> str:
    """The cameras of two lists such as `cam0, cam2`."""
    names = {*cameras.split(", "), *others.split(", ")}
    return ", ".join(sorted(names, key=lambda name: (len(name), name)))


_SKIPPED, _UNTRACKED = "skipped", "untracked"


class FrameRange(NamedTuple):
    """Consecutive frames without a pose, with the reason of the last of them."""

    first: int  # number of the first frame
    last: int  # number of the last frame
    frames: int  # number of frames
    state: str  # of the odometry, or `skipped`, or `untracked`
    reason: str
    defect: ImageDefect | None = None  # of their images, None without one


def ranges_without_pose(
    statistics: RunStatistics, with_pose: Ints, skipped: Sequence[Skipped], untracked: Ints
) -> tuple[list[FrameRange], dict[str, int]]:
    """Consecutive frames with the same state and image defect, and the number of frames by state.

    A frame without a causal pose may have a smoothed one: the first of a monocular initial pair.

    `with_pose`: numbers of the frames that have a pose. `skipped`: frames that could not be read.
    `untracked`: numbers of the frames that `tracking.every` left out.
    """
    unreadable = {each.index: each.reason for each in skipped}
    left_out = set(untracked.tolist())
    reached = np.array(sorted({*statistics.frames, *unreadable, *left_out}), dtype=np.int64)
    missing = np.flatnonzero(~np.isin(reached, with_pose))
    single = [
        _single_frame(frame, statistics, unreadable, left_out)
        for frame in reached[missing].tolist()
    ]
    is_next = np.diff(missing, prepend=-2) == 1
    return _merged(zip(single, is_next.tolist(), strict=True)), _count_states(single)


def _single_frame(
    frame: int, statistics: RunStatistics, unreadable: Mapping[int, str], left_out: set[int]
) -> FrameRange:
    """The range of one frame."""
    if frame in left_out:
        reason = "left out by tracking.every, and not between two tracked frames"
        return FrameRange(frame, frame, 1, _UNTRACKED, reason)
    if frame in unreadable:
        return FrameRange(frame, frame, 1, _SKIPPED, unreadable[frame])
    if frame not in statistics.without_pose:
        reason = "its pose was discarded later"
        return FrameRange(frame, frame, 1, State.LOST.value, reason)
    state, failure = statistics.without_pose[frame]
    if failure is not None and failure.reason is FailureReason.REPEATED_IMAGE:
        return FrameRange(frame, frame, 1, _SKIPPED, describe(failure))
    shown = State.STARTING if state is State.STARTING else State.LOST
    defect = None if failure is None else failure.defect
    return FrameRange(frame, frame, 1, shown.value, describe(failure), defect)


def _merged(frames: Iterable[tuple[FrameRange, bool]]) -> list[FrameRange]:
    """Join ranges of single frames, each with a flag whether it follows the one before it."""
    ranges: list[FrameRange] = []
    for frame, is_next in frames:
        last = ranges[-1] if is_next else None
        if last and last.state == frame.state and last.defect is frame.defect:
            ranges[-1] = frame._replace(first=last.first, frames=last.frames + 1)
        else:
            ranges.append(frame)
    return ranges


def _count_states(frames: Sequence[FrameRange]) -> dict[str, int]:
    count = dict.fromkeys((State.STARTING.value, State.LOST.value, _SKIPPED, _UNTRACKED), 0)
    for frame in frames:
        count[frame.state] += 1
    return count


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


class Profile(NamedTuple):
    """Wall time of the main thread."""

    wall_ms: float
    # by stage, adding up to `wall_ms`; time outside of all stages is `other`
    stages_ms: Mapping[str, float]


def make_profile(wall_ms: float, stages_ms: Mapping[str, float]) -> Profile:
    """Round to microseconds, and add the stage `other`."""
    rounded = {stage: round(spent, 3) for stage, spent in stages_ms.items()}
    wall_ms = round(wall_ms, 3)
    return Profile(wall_ms, {**rounded, "other": round(wall_ms - sum(rounded.values()), 3)})
