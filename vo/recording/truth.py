"""The true path laid onto the estimate, to be drawn beside it, and how far they are apart."""

from __future__ import annotations

import numpy as np

from vo.geometry.similarity import Similarity, umeyama
from vo.geometry.transforms import inverse, transform_points
from vo.types import Bools, Floats, Ints, Trajectory


def laid_onto_pose(truth: Trajectory, stamp_ns: int, world_from_cam0: Floats) -> Floats | None:
    """True positions (N, 3), moved so that the true pose at `stamp_ns` is `world_from_cam0`.

    None where the truth does not reach that moment.
    """
    if not _covers(truth, np.array([stamp_ns]))[0]:
        return None
    nearest = int(np.argmin(np.abs(truth.stamps_ns - stamp_ns)))
    world_from_truth = world_from_cam0 @ inverse(truth.world_from_cam[nearest])
    return transform_points(world_from_truth, truth.positions)


def laid_onto_path(
    truth: Trajectory, path: Trajectory, during_ns: tuple[int, int], *, with_scale: bool
) -> Floats | None:
    """True positions (N, 3) from one moment to another, laid onto a path by least squares.

    None where that cannot be done.
    """
    stamps, true = _positions_at(truth, path.stamps_ns)
    similarity = _fit(true, path.positions[np.isin(path.stamps_ns, stamps)], with_scale)
    if similarity is None:
        return None
    first, last = during_ns
    shown = (truth.stamps_ns >= first) & (truth.stamps_ns <= last)
    return similarity.transform_points(truth.positions[shown])


def errors_along(
    truth: Trajectory, path: Trajectory, *, with_scale: bool
) -> tuple[Ints, Floats] | None:
    """Stamps (n,) and position errors (n,) of a path laid onto the truth by least squares.

    In metres, also where the path has a scale of its own; None where that cannot be done.
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
    """Those of the stamps that the truth covers (n,), and true positions (n, 3) there."""
    stamps = stamps_ns[_covers(truth, stamps_ns)]
    # Floats hold no epoch nanoseconds, but do hold those since the truth's start.
    seconds, known = stamps - truth.stamps_ns[0], truth.stamps_ns - truth.stamps_ns[0]
    true = [np.interp(seconds, known, axis) for axis in truth.positions.T]
    return stamps, np.stack(true, axis=1)


def _covers(truth: Trajectory, stamps_ns: Ints) -> Bools:
    """Which stamps lie within the truth, or half its step outside."""
    step = int(np.median(np.diff(truth.stamps_ns))) // 2 if len(truth) > 1 else 0
    first, last = truth.stamps_ns[0] - step, truth.stamps_ns[-1] + step
    return np.asarray((stamps_ns >= first) & (stamps_ns <= last))
