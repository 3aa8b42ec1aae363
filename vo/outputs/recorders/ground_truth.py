"""The ground truth aligned with the estimate, and position errors."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.similarity import Similarity, umeyama
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bools, Floats, Ints, Trajectory


def aligned_at_pose(truth: Trajectory, stamp_ns: int, world_from_cam0: Floats) -> Floats | None:
    """True positions (N, 3), moved such that the true pose at `stamp_ns` is `world_from_cam0`.

    None if the ground truth does not cover that time.
    """
    if not _covers(truth, np.array([stamp_ns]))[0]:
        return None
    nearest = int(np.argmin(np.abs(truth.stamps_ns - stamp_ns)))
    world_from_truth = world_from_cam0 @ inverse(truth.world_from_cam[nearest])
    return transform_points(world_from_truth, truth.positions)


def aligned_to_path(
    truth: Trajectory, path: Trajectory, during_ns: tuple[int, int], *, with_scale: bool
) -> Floats | None:
    """True positions (N, 3) between two times, aligned with a path by least squares.

    None if the alignment is not determined.
    """
    stamps, true = _positions_at(truth, path.stamps_ns)
    similarity = _fit(true, path.positions[np.isin(path.stamps_ns, stamps)], with_scale)
    if similarity is None:
        return None
    first, last = during_ns
    shown = (truth.stamps_ns >= first) & (truth.stamps_ns <= last)
    return similarity.transform_points(truth.positions[shown])


def position_errors(
    truth: Trajectory, path: Trajectory, *, with_scale: bool
) -> tuple[Ints, Floats] | None:
    """Stamps (n,) and position errors (n,) of a path aligned with the ground truth.

    In metres, also if the path has arbitrary scale; None if the alignment is not determined.
    """
    stamps, true = _positions_at(truth, path.stamps_ns)
    found = path.positions[np.isin(path.stamps_ns, stamps)]
    similarity = _fit(found, true, with_scale)
    if similarity is None:
        return None
    return stamps, np.linalg.norm(similarity.transform_points(found) - true, axis=1)


def _fit(source: Floats, target: Floats, with_scale: bool) -> Similarity | None:
    try:
        return umeyama(source, target, with_scale=with_scale)
    except ValueError:
        return None


def _positions_at(truth: Trajectory, stamps_ns: Ints) -> tuple[Ints, Floats]:
    """The stamps (n,) that the ground truth covers, and true positions (n, 3) at them."""
    stamps = stamps_ns[_covers(truth, stamps_ns)]
    # Relative times: float64 is not exact for nanoseconds since the epoch.
    times, known = stamps - truth.stamps_ns[0], truth.stamps_ns - truth.stamps_ns[0]
    true = [np.interp(times, known, axis) for axis in truth.positions.T]
    return stamps, np.stack(true, axis=1)


def _covers(truth: Trajectory, stamps_ns: Ints) -> Bools:
    """Stamps within the ground truth, or at most half its step outside."""
    step = int(np.median(np.diff(truth.stamps_ns))) // 2 if len(truth) > 1 else 0
    first, last = truth.stamps_ns[0] - step, truth.stamps_ns[-1] + step
    return np.asarray((stamps_ns >= first) & (stamps_ns <= last))
