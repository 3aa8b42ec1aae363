"""Drift over sub-paths of fixed length, as on the KITTI odometry leaderboard."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vo.base.types import Floats, Ints
from vo.outputs.evaluation.statistics import path_distances, relative_poses, rotation_angles_deg

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
