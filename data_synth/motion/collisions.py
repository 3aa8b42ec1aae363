"""Collision check of a whole path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.motion.spline import PosePath
from vo.base.types import Floats

Clearance = Callable[[Floats], Floats]

_COARSE_M = 1.0
_FINE_M = 0.015
_AT_ONCE = 128  # points; worlds of thousands of solids compare each point with each solid


@dataclass(frozen=True, eq=False)
class Collision:
    """Where a path is too close to a solid: the point (3,), its time and the distance."""

    point: Floats
    time_s: float
    distance_m: float


def find_collision(path: PosePath, clearance: Clearance, margin_m: float) -> Collision | None:
    """Find a point where a path is closer than a margin to a solid; None if there is none.

    The distance to the nearest solid changes by at most the length moved (it is 1-Lipschitz), so
    that a distance at the middle of a stretch bounds the whole stretch. Stretches that are not
    proven to be free are halved until they are 3 cm long.

    `clearance`: distances (N,) of points (N, 3) to the nearest solid.
    """
    # The controls bound the speed of the spline, and so the length of every stretch.
    spans = np.linalg.norm(np.diff(path.controls[:, :3], axis=0), axis=1)
    longest = np.maximum(np.maximum(spans[:-2], spans[1:-1]), spans[2:])
    along = np.concatenate([[0.0], np.cumsum(longest + 1e-9)])
    times = (np.arange(1, len(path.controls) - 1) - path.lead) * path.step_s
    half = _COARSE_M
    middles = np.arange(half, along[-1] + half, 2.0 * half)
    while len(middles):
        at_s = np.interp(middles, along, times)
        places = path.world_from_body(at_s)[:, :3, 3]
        distances = _by_parts(clearance, places)
        worst = int(np.argmin(distances))
        if distances[worst] < margin_m:
            return Collision(places[worst], float(at_s[worst]), float(distances[worst]))
        if half <= _FINE_M:
            return None
        half /= 2.0
        near = middles[distances < margin_m + 2.0 * half]
        middles = np.concatenate([near - half, near + half])
    return None


def _by_parts(clearance: Clearance, points: Floats) -> Floats:
    parts = [clearance(points[i : i + _AT_ONCE]) for i in range(0, len(points), _AT_ONCE)]
    return np.concatenate(parts)
