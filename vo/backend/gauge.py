"""What holds a window in place: its fixed poses, or else its first, and in mono its scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.types import Bools, Floats, WindowProblem


class Gauge(NamedTuple):
    """What of a window of K poses is held.

    Attributes:
        held: (K,) poses that stay where they are.
        scaled: pose that is held loosely where it is, to keep a mono window's scale, or None.
        sigmas: (6,) how loosely, in its tangent.
    """

    held: Bools
    scaled: int | None
    sigmas: Floats


def gauge_of(problem: WindowProblem) -> Gauge:
    """Hold the fixed poses; a window without any is held by its first pose, and mono's scale."""
    held, poses = problem.fixed.copy(), problem.world_from_cam
    if not held.any():
        held[0] = True
    nothing = Gauge(held, None, np.full(6, np.inf))
    if problem.fixed.sum() >= 2 or problem.baseline_m > 0.0 or len(poses) < 2:
        return nothing
    anchor = int(np.flatnonzero(held)[0])
    distance = np.linalg.norm(poses[:, :3, 3] - poses[anchor, :3, 3], axis=1)
    farthest = int(np.argmax(distance))
    if farthest == anchor:
        return nothing
    length = float(distance[farthest])
    return Gauge(held, farthest, np.r_[np.full(3, 1.0), np.full(3, 0.02 * length)])
