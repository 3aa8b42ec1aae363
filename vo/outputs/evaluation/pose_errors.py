"""Errors of poses (ATE), of motions (RPE) and of KITTI's segments, and their statistics."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, Ints


@dataclass(frozen=True)
class Statistics:
    """Statistics of a set of errors, in the unit of the errors."""

    rmse: float  # root of the mean square
    mean: float
    median: float
    max: float  # largest
    min: float  # smallest
    std: float  # standard deviation of the population

    @staticmethod
    def of(errors: Floats) -> Statistics:
        """The statistics of (N,) errors, N at least 1."""
        return Statistics(
            rmse=float(np.sqrt(np.mean(errors**2))),
            mean=float(np.mean(errors)),
            median=float(np.median(errors)),
            max=float(np.max(errors)),
            min=float(np.min(errors)),
            std=float(np.std(errors)),
        )

    def to_dict(self) -> dict[str, float]:
        """The numbers by name."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of N poses or N motions."""

    translation_m: Floats  # (N,) lengths in metres
    rotation_deg: Floats  # (N,) angles in degrees, 0 to 180

    def __len__(self) -> int:
        return len(self.translation_m)

    @property
    def translation(self) -> Statistics:
        """Statistics of the lengths, in metres."""
        return Statistics.of(self.translation_m)

    @property
    def rotation(self) -> Statistics:
        """Statistics of the angles, in degrees."""
        return Statistics.of(self.rotation_deg)

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Both statistics, by name and unit."""
        return {
            "translation_m": self.translation.to_dict(),
            "rotation_deg": self.rotation.to_dict(),
        }


def relative_poses(first: Floats, second: Floats) -> Floats:
    """first_from_second, (N, 4, 4), of two poses (N, 4, 4) in the same world."""
    return inverse(first) @ second


def rotation_angles_deg(rotations: Floats) -> Floats:
    """Angles (N,) in degrees of rotations (N, 3, 3), accurate near 0 and near 180."""
    twice_sine_axis = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ]
    )
    twice_cosine = np.trace(rotations, axis1=1, axis2=2) - 1.0
    angles = np.arctan2(np.linalg.norm(twice_sine_axis, axis=0), twice_cosine)
    return np.asarray(np.rad2deg(angles), dtype=np.float64)


def path_distances(positions: Floats) -> Floats:
    """Metres travelled (N,) from the first of (N, 3) positions to each."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def absolute_errors(estimate: Floats, reference: Floats) -> PoseErrors:
    """Errors of aligned poses (N, 4, 4) against reference poses (N, 4, 4) in the same world.

    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012 (ATE).
    """
    offsets = estimate[:, :3, 3] - reference[:, :3, 3]
    rotations = relative_poses(reference, estimate)[:, :3, :3]
    return PoseErrors(np.linalg.norm(offsets, axis=1), rotation_angles_deg(rotations))


def rotation_errors_alone(estimate: Floats, reference: Floats) -> Floats:
    """Angles (N,) in degrees between poses (N, 4, 4) aligned by their rotations alone.

    On a nearly straight path, positions hardly determine the roll about it: an alignment by
    positions may be off by tens of degrees. An alignment by rotations is not affected.

    Source: Hartley et al., Rotation averaging, IJCV 103, 2013 (chordal L2 mean).
    """
    true, rotations = reference[:, :3, :3], estimate[:, :3, :3]
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", true, rotations))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation_angles_deg(np.swapaxes(true, 1, 2) @ rotation @ rotations)


def relative_errors(estimate: Floats, reference: Floats, pairs: Ints) -> PoseErrors:
    """Errors of the motions between poses, for pairs (P, 2) of rows in both (N, 4, 4).

    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012 (RPE).
    """
    first, second = pairs[:, 0], pairs[:, 1]
    true_motion = relative_poses(reference[first], reference[second])
    motion = relative_poses(estimate[first], estimate[second])
    error = relative_poses(true_motion, motion)
    lengths = np.linalg.norm(error[:, :3, 3], axis=1)
    return PoseErrors(lengths, rotation_angles_deg(error[:, :3, :3]))


def pairs_over_frames(count: int, delta: int) -> Ints:
    """All pairs (i, i + delta) among `count` poses, as (P, 2)."""
    delta = min(delta, count)  # no pairs, and no overflow, for any larger delta
    first = np.arange(count - delta, dtype=np.int64)
    return np.column_stack([first, first + delta])


def pairs_over_metres(positions: Floats, delta_m: float, tolerance: float = 0.1) -> Ints:
    """Pair each of (N, 3) positions with the later one nearest to `delta_m` along the path.

    Pairs off by more than `tolerance * delta_m` are left out. Returns (P, 2), P may be 0. Same
    pairs as `evo_rpe --all_pairs --delta_unit m`, which measures along the estimated path.
    """
    distances = path_distances(positions)
    pairs = []
    for first in range(len(distances) - 1):
        second = _nearest_later(distances, first, delta_m)
        if abs(distances[second] - distances[first] - delta_m) <= tolerance * delta_m:
            pairs.append((first, second))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _nearest_later(distances: Floats, first: int, delta_m: float) -> int:
    """Row after `first` whose distance from it is nearest to `delta_m`; the earliest of equals."""
    after = int(np.searchsorted(distances, distances[first] + delta_m, side="left"))
    after = min(max(after, first + 1), len(distances) - 1)
    before = int(np.searchsorted(distances, distances[after - 1], side="left"))
    before = max(before, first + 1)
    error_before = abs(distances[before] - distances[first] - delta_m)
    error_after = abs(distances[after] - distances[first] - delta_m)
    return before if error_before <= error_after else after


KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
SHORT_LENGTHS_M = (5.0, 10.0, 20.0, 50.0)
_KITTI_STEP = 10
_SHORT_STEP = 1


@dataclass(frozen=True)
class LengthDrift:
    """Mean drift over all sub-paths of one length."""

    length_m: float
    count: int  # number of sub-paths
    translation_percent: float  # position error at the end, relative to the length
    rotation_deg_per_m: float  # rotation error at the end, relative to the length


@dataclass(frozen=True)
class SegmentDrift:
    """Drift by length, and its mean over all sub-paths of all lengths."""

    lengths: tuple[LengthDrift, ...]
    translation_percent: float
    rotation_deg_per_m: float

    def to_dict(self) -> dict[str, Any]:
        """All figures, ready for JSON."""
        return {**asdict(self), "lengths": [asdict(drift) for drift in self.lengths]}


def segment_drift(estimate: Floats, reference: Floats) -> SegmentDrift | None:
    """Drift of poses (N, 4, 4) over sub-paths measured along the reference (N, 4, 4).

    On paths over 100 m the lengths are 100 to 800 m and a sub-path starts at every tenth pose, as
    in KITTI; on shorter paths the lengths are 5 to 50 m and a sub-path starts at every pose. None
    if the path is shorter than the shortest length.

    Source: Geiger et al., Are we ready for autonomous driving? CVPR 2012, and the KITTI odometry
        development kit.
    """
    distances = path_distances(reference[:, :3, 3])
    is_long = distances[-1] > KITTI_LENGTHS_M[0]
    lengths, step = (KITTI_LENGTHS_M, _KITTI_STEP) if is_long else (SHORT_LENGTHS_M, _SHORT_STEP)
    drifts, all_errors = [], []
    for length in lengths:
        pairs = _pairs_of_length(distances, length, step)
        if len(pairs) == 0:
            continue
        errors = _drift_of_pairs(estimate, reference, pairs, length)
        all_errors.append(errors)
        percent, deg_per_m = errors.mean(axis=0)
        drifts.append(LengthDrift(length, len(pairs), float(percent), float(deg_per_m)))
    if not drifts:
        return None
    percent, deg_per_m = np.concatenate(all_errors).mean(axis=0)
    return SegmentDrift(tuple(drifts), float(percent), float(deg_per_m))


def _pairs_of_length(distances: Floats, length_m: float, step: int) -> Ints:
    """Pairs (P, 2): every `step`-th pose, and the first pose more than `length_m` after it."""
    first = np.arange(0, len(distances), step, dtype=np.int64)
    last = np.searchsorted(distances, distances[first] + length_m, side="right")
    pairs = np.column_stack([first, last])
    return np.asarray(pairs[last < len(distances)])


def _drift_of_pairs(estimate: Floats, reference: Floats, pairs: Ints, length_m: float) -> Floats:
    """(P, 2) errors: translation in percent, rotation in degrees per metre."""
    first, last = pairs[:, 0], pairs[:, 1]
    error = relative_poses(
        relative_poses(estimate[first], estimate[last]),
        relative_poses(reference[first], reference[last]),
    )
    percent = 100.0 * np.linalg.norm(error[:, :3, 3], axis=1) / length_m
    return np.column_stack([percent, rotation_angles_deg(error[:, :3, :3]) / length_m])
