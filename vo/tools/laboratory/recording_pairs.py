"""Pairs of frames of a recording whose true motion is known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vo.base.errors import EvaluationError, SourceError
from vo.base.types import Bools, Floats, Frame, Trajectory
from vo.outputs.evaluation.association import associate
from vo.recordings.sources.source import Recording
from vo.tools.laboratory.comparison import ImagePair, choose_pairs, true_motion


@dataclass(frozen=True, eq=False)
class PlannedPairs:
    """Pairs to compare methods on; images are read when they are iterated."""

    recording: Recording  # where they are
    world_from_cam: Floats  # (N, 4, 4) true pose of each frame, NaN where it is not known
    frames: tuple[tuple[int, int], ...]  # gap and number of the first frame of each pair
    without_pairs: tuple[int, ...]  # gaps of which there are none

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[ImagePair]:
        """Pairs; those with a frame that cannot be read are left out."""
        for gap, number in self.frames:
            first, second = (self._read(n) for n in (number, number + gap))
            if first is None or second is None or first.image0.shape != second.image0.shape:
                continue
            depths = None
            if first.depth is not None and second.depth is not None:
                depths = first.depth, second.depth
            poses = self.world_from_cam[number], self.world_from_cam[number + gap]
            yield ImagePair(gap, first.image0, second.image0, true_motion(*poses), depths)

    def _read(self, number: int) -> Frame | None:
        return next(iter(list(self.recording.frames(number, number + 1))), None)


def plan_pairs(recording: Recording, gaps: Sequence[int], wanted: int) -> PlannedPairs:
    """Choose at most `wanted` pairs for each gap.

    Raises:
        SourceError: the recording has no ground truth, or no pair of frames has any.
    """
    if recording.ground_truth is None:
        raise SourceError(
            f"{recording.name} has no ground truth, by which methods could be scored; with "
            "`frame=N` they are compared in one image by number, spread and time; vo synth makes "
            "recordings with ground truth"
        )
    poses, known = _poses_of_frames(recording, recording.ground_truth)
    chosen = list(choose_pairs(known, gaps, wanted))
    frames = tuple((gap, int(first)) for gap, firsts in chosen for first in firsts)
    if not frames:
        listed = ", ".join(map(str, gaps))
        raise SourceError(
            f"{recording.name}: no frames with ground truth are {listed} frames apart "
            f"({np.count_nonzero(known)} of {len(recording)} frames have a true pose); give "
            "smaller `gaps`"
        )
    return PlannedPairs(
        recording, poses, frames, tuple(g for g, firsts in chosen if not len(firsts))
    )


def _poses_of_frames(recording: Recording, truth: Trajectory) -> tuple[Floats, Bools]:
    """True poses (N, 4, 4) of all frames, interpolated, and whether they are known (N,)."""
    stamps = recording.stamps_ns
    poses = np.full((len(stamps), 4, 4), np.nan)
    frames = Trajectory(stamps, np.broadcast_to(np.eye(4), poses.shape))
    try:
        matched = associate(frames, truth, interpolated=True)
    except EvaluationError:
        return poses, np.zeros(len(stamps), dtype=bool)
    rows = np.searchsorted(stamps, matched.stamps_ns)
    poses[rows] = matched.reference
    return poses, np.isfinite(poses[:, 0, 0])
