"""Gauge of a window: its fixed poses, or else its first one, and in mono its scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Floats
from vo.engine.backend.window_problem import WindowProblem


class Gauge(NamedTuple):
    """The gauge freedom that is fixed in a window of K poses, of which (K,) are held.

    Attributes:
        scaled: pose with a loose prior that keeps the scale of a mono window, or None.
        sigmas: (6,) standard deviations of that prior, in the tangent of the pose.
    """

    held: Bools
    scaled: int | None
    sigmas: Floats


def gauge_of(problem: WindowProblem) -> Gauge:
    """The fixed poses, in a window without any the first one; in mono also the scale."""
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
