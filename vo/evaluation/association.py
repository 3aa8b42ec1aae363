"""Which estimated pose belongs to which true one, by time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vo.errors import EvaluationError
from vo.geometry.transforms import interpolate
from vo.types import Floats, Ints, Trajectory

AssociationMethod = Literal["nearest", "interpolated"]

_NS_PER_S = 1e9
_GAP_INTERVALS = 3.0


@dataclass(frozen=True, eq=False)
class Matched:
    """Poses of the same moments.

    Attributes:
        stamps_ns: (N,) the estimate's stamps, increasing.
        estimate: (N, 4, 4) world_from_cam in the estimate's world.
        reference: (N, 4, 4) world_from_cam in the reference's world.
        method: whether the reference's poses are its nearest ones or interpolated.
        tolerance_s: how far apart in time two poses of one moment may be.
    """

    stamps_ns: Ints
    estimate: Floats
    reference: Floats
    method: AssociationMethod
    tolerance_s: float

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def seconds(self) -> Floats:
        """(N,) seconds since the first."""
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
) -> Matched:
    """Pair the poses of two trajectories by stamp.

    Args:
        estimate: what is judged.
        reference: what is true.
        tolerance_s: largest difference of stamps; with interpolation, how far beyond its ends.
        interpolated: whether to take the reference on the SE(3) geodesic at the estimate's stamps
            instead of its nearest pose.

    Raises:
        EvaluationError: not one pose of one is near one of the other.
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
    return Matched(
        estimate.stamps_ns[rows], estimate.world_from_cam[rows], poses, method, tolerance_s
    )


def nearest_pairs(first_ns: Ints, second_ns: Ints, tolerance_ns: int) -> tuple[Ints, Ints]:
    """Rows of increasing stamps that belong together, each row used once.

    Each stamp of the shorter list takes its nearest in the longer, the earlier of two equally near;
    where two want the same one, the nearer gets it.
    """
    if len(first_ns) == 0 or len(second_ns) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    if len(second_ns) < len(first_ns):
        second, first = nearest_pairs(second_ns, first_ns, tolerance_ns)
        return first, second
    after = np.searchsorted(second_ns, first_ns).clip(1, max(len(second_ns) - 1, 1))
    after = np.minimum(after, len(second_ns) - 1)
    before = np.maximum(after - 1, 0)
    is_before = first_ns - second_ns[before] <= second_ns[after] - first_ns
    partner = np.where(is_before, before, after)
    miss = np.abs(second_ns[partner] - first_ns)
    order = np.lexsort((miss, partner))
    is_best = np.concatenate([[True], np.diff(partner[order]) != 0])
    rows = np.sort(order[is_best])
    rows = rows[miss[rows] <= tolerance_ns]
    return rows.astype(np.int64), partner[rows].astype(np.int64)


def typical_interval_ns(stamps_ns: Ints) -> float:
    """Median time between stamps; 0 for fewer than two."""
    return float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0


def coverage(stamps_ns: Ints, reference_ns: Ints) -> float:
    """Share of the reference's time, 0 to 1, between the first and the last matched pose."""
    whole = float(reference_ns[-1] - reference_ns[0])
    matched = float(stamps_ns[-1] - stamps_ns[0])
    return min(matched / whole, 1.0) if whole > 0.0 else 1.0


def _interpolated(stamps_ns: Ints, reference: Trajectory, tolerance_ns: int) -> tuple[Ints, Floats]:
    """Rows of stamps_ns inside the reference, and its poses there; holes in it are not bridged."""
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
    """The reference's pose at a stamp, or None beyond its ends and in its holes."""
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
    share = float(stamp_ns - stamps_ns[before]) / gap_ns
    return interpolate(poses[before], poses[after], share)


def _no_overlap(estimate: Trajectory, reference: Trajectory, tolerance_s: float) -> str:
    spans = " and ".join(
        f"{name} {t.stamps_ns[0] / _NS_PER_S:.3f} to {t.stamps_ns[-1] / _NS_PER_S:.3f} s"
        for name, t in (("estimate", estimate), ("reference", reference))
    )
    return (
        f"no stamps within {tolerance_s:g} s of each other: {spans}; "
        "give the truth of the same recording, or a larger tolerance"
    )
