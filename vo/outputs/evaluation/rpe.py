"""Relative errors (RPE): errors of the motion over a number of frames or metres."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats, Ints
from vo.outputs.evaluation.statistics import (
    PoseErrors,
    path_distances,
    relative_poses,
    rotation_angles_deg,
)


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
