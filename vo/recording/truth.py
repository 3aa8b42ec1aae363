"""The true path laid onto the estimate, to be drawn beside it."""

from __future__ import annotations

import numpy as np

from vo.geometry.similarity import umeyama
from vo.geometry.transforms import inverse, transform_points
from vo.types import Floats, Ints, Trajectory


def laid_onto_pose(truth: Trajectory, stamp_ns: int, world_from_cam0: Floats) -> Floats | None:
    """True positions (N, 3), moved so that the true pose at `stamp_ns` is `world_from_cam0`.

    None where the truth does not reach that moment.
    """
    if not _covers(truth, np.array([stamp_ns]))[0]:
        return None
    nearest = int(np.argmin(np.abs(truth.stamps_ns - stamp_ns)))
    world_from_truth = world_from_cam0 @ inverse(truth.world_from_cam[nearest])
    return transform_points(world_from_truth, truth.positions)


def laid_onto_path(truth: Trajectory, path: Trajectory, *, with_scale: bool) -> Floats | None:
    """True positions (N, 3), laid onto a path by least squares; None where that cannot be done."""
    covered = _covers(truth, path.stamps_ns)
    stamps = path.stamps_ns[covered]
    # Floats hold no epoch nanoseconds, but do hold those since the truth's start.
    seconds, known = stamps - truth.stamps_ns[0], truth.stamps_ns - truth.stamps_ns[0]
    true = np.stack([np.interp(seconds, known, axis) for axis in truth.positions.T], axis=1)
    try:
        similarity = umeyama(true, path.positions[covered], with_scale=with_scale)
    except ValueError:
        return None
    return similarity.transform_points(truth.positions)


def _covers(truth: Trajectory, stamps_ns: Ints) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which stamps lie within the truth, or half its step outside."""
    step = int(np.median(np.diff(truth.stamps_ns))) // 2 if len(truth) > 1 else 0
    first, last = truth.stamps_ns[0] - step, truth.stamps_ns[-1] + step
    return np.asarray((stamps_ns >= first) & (stamps_ns <= last))
