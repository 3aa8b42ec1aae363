"""Association of estimated poses with reference poses by stamp."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vo.base.errors import EvaluationError
from vo.base.files.bounded_files import read_text
from vo.base.geometry.transforms import interpolate
from vo.base.types import Bools, Floats, Ints, Trajectory

AssociationMethod = Literal["nearest", "interpolated"]

_NS_PER_S = 1e9
_GAP_INTERVALS = 3.0
"""Longest gap bridged by interpolation, in typical intervals of the reference."""


@dataclass(frozen=True, eq=False)
class MatchedPoses:
    """Estimated and reference poses at the same times."""

    stamps_ns: Ints  # (N,) stamps of the estimate, increasing
    estimate: Floats  # (N, 4, 4) world_from_cam in the estimate's world
    reference: Floats  # (N, 4, 4) world_from_cam in the reference's world
    method: AssociationMethod  # reference poses nearest in time, or interpolated
    tolerance_s: float  # largest difference between the stamps of a pair

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def seconds(self) -> Floats:
        """(N,) seconds since the first matched pose."""
        return np.asarray((self.stamps_ns - self.stamps_ns[0]) / _NS_PER_S)

    @property
    def longest_gap_s(self) -> float:
        """Longest time without a matched pose between the first and the last."""
        return float(np.diff(self.stamps_ns).max(initial=0) / _NS_PER_S)


def associate(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    tolerance_s: float = 0.01,
    interpolated: bool = False,
) -> MatchedPoses:
    """Pair the poses of two trajectories by stamp.

    `tolerance_s`: largest difference of stamps; with interpolation, the largest distance of a stamp
    from the ends of the reference. `interpolated`: interpolate the reference on SE(3) geodesics at
    the estimate's stamps, instead of taking its nearest pose.

    Raises:
        EvaluationError: no pair of poses is within the tolerance.
    """
    tolerance_ns = round(tolerance_s * _NS_PER_S)
    if interpolated:
        rows, poses = _interpolated(estimate.stamps_ns, reference, tolerance_ns)
        method: AssociationMethod = "interpolated"
    else:
        rows, partners = nearest_pairs(estimate.stamps_ns, reference.stamps_ns, tolerance_ns)
        poses = reference.world_from_cam[partners]
        method = "nearest"
    if len(rows) == 0:
        raise EvaluationError(_no_overlap(estimate, reference, tolerance_s))
    return MatchedPoses(
        estimate.stamps_ns[rows], estimate.world_from_cam[rows], poses, method, tolerance_s
    )


def nearest_pairs(first_ns: Ints, second_ns: Ints, tolerance_ns: int) -> tuple[Ints, Ints]:
    """One-to-one association of two lists of increasing stamps, as two arrays of row indices.

    Each stamp of the shorter list is paired with the nearest of the longer list, the earlier of two
    equally near; of several stamps paired with the same one, only the nearest is kept.
    """
    if len(first_ns) == 0 or len(second_ns) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    if len(second_ns) < len(first_ns):
        second, first = nearest_pairs(second_ns, first_ns, tolerance_ns)
        return first, second
    after = np.searchsorted(second_ns, first_ns).clip(1, max(len(second_ns) - 1, 1))
    after = np.minimum(after, len(second_ns) - 1)
    before = np.maximum(after - 1, 0)
    before_is_nearer = first_ns - second_ns[before] <= second_ns[after] - first_ns
    partner = np.where(before_is_nearer, before, after)
    difference = np.abs(second_ns[partner] - first_ns)
    order = np.lexsort((difference, partner))
    is_best = np.concatenate([[True], np.diff(partner[order]) != 0])
    rows = np.sort(order[is_best])
    rows = rows[difference[rows] <= tolerance_ns]
    return rows.astype(np.int64), partner[rows].astype(np.int64)


def typical_interval_ns(stamps_ns: Ints) -> float:
    """Median time between stamps; 0 for fewer than two."""
    return float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0


def coverage(stamps_ns: Ints, reference_ns: Ints) -> float:
    """Fraction (0 to 1) of the reference's duration between first and last matched pose."""
    whole = float(reference_ns[-1] - reference_ns[0])
    matched = float(stamps_ns[-1] - stamps_ns[0])
    return min(matched / whole, 1.0) if whole > 0.0 else 1.0


def _interpolated(stamps_ns: Ints, reference: Trajectory, tolerance_ns: int) -> tuple[Ints, Floats]:
    """Rows of `stamps_ns` inside the reference, and its poses there; gaps are not bridged."""
    limit_ns = max(2.0 * tolerance_ns, _GAP_INTERVALS * typical_interval_ns(reference.stamps_ns))
    rows, poses = [], []
    for row, stamp in enumerate(stamps_ns):
        pose = _pose_at(int(stamp), reference, limit_ns, tolerance_ns)
        if pose is not None:
            rows.append(row)
            poses.append(pose)
    return np.array(rows, dtype=np.int64), np.array(poses).reshape(-1, 4, 4)


def _pose_at(
    stamp_ns: int, reference: Trajectory, limit_ns: float, tolerance_ns: int
) -> Floats | None:
    """Pose of the reference at a stamp; None beyond its ends and in its gaps."""
    stamps_ns, poses = reference.stamps_ns, reference.world_from_cam
    after = int(np.searchsorted(stamps_ns, stamp_ns))
    if after < len(stamps_ns) and stamps_ns[after] == stamp_ns:
        return np.asarray(poses[after])
    if after == 0 or after == len(stamps_ns):
        end = min(after, len(stamps_ns) - 1)
        return np.asarray(poses[end]) if abs(stamps_ns[end] - stamp_ns) <= tolerance_ns else None
    before = after - 1
    gap_ns = float(stamps_ns[after] - stamps_ns[before])
    if gap_ns > limit_ns:
        return None
    fraction = float(stamp_ns - stamps_ns[before]) / gap_ns
    return interpolate(poses[before], poses[after], fraction)


def _no_overlap(estimate: Trajectory, reference: Trajectory, tolerance_s: float) -> str:
    spans = " and ".join(
        f"{name} {t.stamps_ns[0] / _NS_PER_S:.3f} to {t.stamps_ns[-1] / _NS_PER_S:.3f} s"
        for name, t in (("estimate", estimate), ("reference", reference))
    )
    return (
        f"no stamps within {tolerance_s:g} s of each other: {spans}; "
        "use the ground truth of the same recording, or a larger `tolerance_s`"
    )


_COLUMNS = ["frame", "stamp_ns", "segment"]


def frame_numbers(
    estimate: Path, stamps_ns: Ints, summary: Mapping[str, Any], frames: int
) -> Ints | None:
    """Numbers (N,) of the frames of some poses, from `poses.csv` beside the trajectory of a run.

    `stamps_ns`: (N,) stamps of its poses. `frames`: number of poses of the ground truth.

    Returns None if it is unknown, or if the ground truth may not have one pose for each frame of
    the recording: the run had another number of frames, or left some of them out.
    """
    is_whole = summary.get("start") in (None, 0) and summary.get("stride") in (None, 1)
    if not is_whole or summary.get("frames") != frames:
        return None
    found = _column(estimate, stamps_ns, 0)
    if found is None or not len(found) or found.min() < 0 or found.max() >= frames:
        return None
    return found


def segment_numbers(estimate: Path, stamps_ns: Ints) -> Ints | None:
    """Numbers (N,) of the segments of some poses, None if they are unknown.

    Merged segments have one number, and another segment may lie between them.

    `stamps_ns`: (N,) stamps of its poses.
    """
    return _column(estimate, stamps_ns, 2)


def _column(estimate: Path, stamps_ns: Ints, column: int) -> Ints | None:
    """Whole numbers (N,) of a column of `poses.csv`, None without them."""
    try:
        lines = read_text(estimate.with_name("poses.csv")).splitlines()
        rows = [line.split(",", 3) for line in lines]
        number_of = {int(row[1]): int(row[column]) for row in rows[1:]}
        if not rows or rows[0][:3] != _COLUMNS:
            return None
        return np.array([number_of[stamp] for stamp in stamps_ns.tolist()], dtype=np.int64)
    except (OSError, ValueError, IndexError, KeyError):
        return None


_FILES = ("frames.csv", "frames.csv.partial")  # the latter is written until a run ends


def tracked_part(causal: Trajectory, folder: Path) -> Trajectory:
    """The causal poses of frames that were tracked; all of them without `frames.csv`.

    Lost frames have a pose in `causal.tum`, too, if an inertial sensor predicts it.

    `causal`: the causal path, or a part of it.
    """
    kept = ~predicted(causal, folder)
    return Trajectory(causal.stamps_ns[kept], causal.world_from_cam[kept])


def predicted(causal: Trajectory, folder: Path) -> Bools:
    """(N,) which causal poses were predicted; none without `frames.csv`."""
    for name in _FILES:
        with suppress(OSError, ValueError, KeyError, TypeError, OverflowError, csv.Error):
            rows = csv.DictReader(read_text(folder / name).splitlines())
            lost = [int(row["stamp_ns"]) for row in rows if row["state"] != "tracking"]
            return np.isin(causal.stamps_ns, np.array(lost, np.int64))
    return np.zeros(len(causal), dtype=bool)
