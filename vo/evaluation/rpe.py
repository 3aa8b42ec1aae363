"""Relative errors (RPE): how wrong the motion is over some frames or some metres."""

from __future__ import annotations

import numpy as np

from vo.evaluation.statistics import PoseErrors, path_distances, relative, rotation_angles_deg
from vo.types import Floats, Ints


def relative_errors(estimate: Floats, reference: Floats, pairs: Ints) -> PoseErrors:
    """Errors of the motions between poses, for pairs (P, 2) of rows in both (N, 4, 4).

    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012 (RPE).
    """
    first, second = pairs[:, 0], pairs[:, 1]
    true_motion = relative(reference[first], reference[second])
    motion = relative(estimate[first], estimate[second])
    error = relative(true_motion, motion)
    lengths = np.linalg.norm(error[:, :3, 3], axis=1)
    return PoseErrors(lengths, rotation_angles_deg(error[:, :3, :3]))


def pairs_over_frames(count: int, delta: int) -> Ints:
    """All pairs (i, i + delta) among `count` poses, as (P, 2)."""
    delta = min(delta, count)  # beyond, there are none, and no number is too large
    first = np.arange(count - delta, dtype=np.int64)
    return np.column_stack([first, first + delta])


def pairs_over_metres(positions: Floats, delta_m: float, tolerance: float = 0.1) -> Ints:
    """For each of (N, 3) positions the later one whose way from there is nearest to `delta_m`.

    Pairs off by more than `tolerance * delta_m` are left out. Returns (P, 2), P may be 0. It is the
    choice of `evo_rpe --all_pairs --delta_unit m`, which measures the way along the estimate.
    """
    distances = path_distances(positions)
    pairs = []
    for first in range(len(distances) - 1):
        second = _nearest_later(distances, first, delta_m)
        if abs(distances[second] - distances[first] - delta_m) <= tolerance * delta_m:
            pairs.append((first, second))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _nearest_later(distances: Floats, first: int, delta_m: float) -> int:
    """Row after `first` whose distance from it is nearest to delta_m; of equals the earliest."""
    after = int(np.searchsorted(distances, distances[first] + delta_m, side="left"))
    after = min(max(after, first + 1), len(distances) - 1)
    before = int(np.searchsorted(distances, distances[after - 1], side="left"))
    before = max(before, first + 1)
    miss_before = abs(distances[before] - distances[first] - delta_m)
    miss_after = abs(distances[after] - distances[first] - delta_m)
    return before if miss_before <= miss_after else after
