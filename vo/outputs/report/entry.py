"""One run of a report: its results, and its evaluation against the ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vo.base.types import Bytes, Floats, Ints, Trajectory
from vo.outputs.evaluation.evaluation import Evaluation
from vo.outputs.report.run_folder import RunRecord

_NS_PER_S = 1e9
_LABEL_LENGTH = 40
_GAP_STEPS = 2.5  # a single missing frame is not a gap


@dataclass(frozen=True, eq=False)
class Thumbnail:
    """A small image (H, W) of a frame, and the event at this frame."""

    frame: int
    seconds: float
    event: str
    image: Bytes


@dataclass(frozen=True, eq=False)
class Entry:
    """A run in a report."""

    name: str
    number: int  # index in the report, which determines the colour
    run: RunRecord
    evaluation: Evaluation | None = None  # against the ground truth, None without one
    truth: Trajectory | None = None  # the whole ground truth, None without one
    truth_note: str = ""  # source of the ground truth, or the reason why there is none
    notes: tuple[str, ...] = ()
    thumbnails: tuple[Thumbnail, ...] = ()  # images of frames with events
    zero_ns: int = 0  # stamp of time 0 in the plots
    # evaluations of the other segments than the longest, each aligned separately
    others: tuple[Evaluation, ...] = ()
    # root mean square of the position error of the causal path, aligned separately; None if unknown
    causal_ate_m: float | None = None

    @property
    def label(self) -> str:
        """The name for legends: shortened; matplotlib would hide a leading underscore."""
        name = self.name
        if len(name) > _LABEL_LENGTH:
            name = f"{name[: _LABEL_LENGTH // 2]}…{name[-_LABEL_LENGTH // 2 :]}"
        return f"\u2009{name}" if name.startswith("_") else name

    def seconds(self, stamps_ns: Ints) -> Floats:
        """Stamps on the time axis of the plots."""
        return np.asarray((stamps_ns - self.zero_ns) / _NS_PER_S, dtype=np.float64)

    @property
    def untracked_s(self) -> list[tuple[float, float]]:
        """Time intervals without a causal pose, from the frame before to the frame after.

        They include the time before the first pose.
        """
        return self._intervals(is_start_posed=False)

    @property
    def without_pose_s(self) -> list[tuple[float, float]]:
        """The same without the start, where its frames have a pose since the first map."""
        return self._intervals(is_start_posed=True)

    def _intervals(self, *, is_start_posed: bool) -> list[tuple[float, float]]:
        frames = self.run.frames
        if frames is None or not len(frames):
            return []
        is_missing = frames.state != "tracking"
        if is_start_posed:
            has_pose = np.isin(frames.stamp_ns, self.run.trajectory.stamps_ns)
            is_missing &= ~((frames.state == "starting") & has_pose)
        missing = np.concatenate([[False], is_missing, [False]])
        edges = np.flatnonzero(np.diff(missing.astype(np.int8)))
        seconds = self.seconds(frames.stamp_ns)
        last = len(frames) - 1
        return [
            (float(seconds[max(first - 1, 0)]), float(seconds[min(end, last)]))
            for first, end in zip(edges[::2], edges[1::2], strict=True)
        ]


def gaps(stamps_ns: Ints) -> list[int]:
    """Rows of a path before which poses are missing, so that its line is interrupted there."""
    steps = np.diff(stamps_ns)
    if len(steps) == 0:
        return []
    return [int(row) + 1 for row in np.flatnonzero(steps > _GAP_STEPS * np.median(steps))]


def names_of(folders: Sequence[Path]) -> list[str]:
    """Short unique names of run folders: the last parts of their paths, as few as possible."""
    parts = [folder.resolve().parts for folder in folders]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-count:]) for each in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{folder} ({number})" for number, folder in enumerate(folders, start=1)]


def first_stamps(runs: Sequence[RunRecord]) -> list[int]:
    """The stamp of time 0 of each run; a common one if all runs overlap in time."""
    spans = [_span(run) for run in runs]
    latest_begin = max(begin for begin, _ in spans)
    earliest_end = min(end for _, end in spans)
    if latest_begin <= earliest_end:
        return [min(begin for begin, _ in spans)] * len(runs)
    return [begin for begin, _ in spans]


def _span(run: RunRecord) -> tuple[int, int]:
    stamps = run.trajectory.stamps_ns if run.frames is None else run.frames.stamp_ns
    return (int(stamps[0]), int(stamps[-1])) if len(stamps) else (0, 0)
