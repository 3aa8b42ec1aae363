"""When a frame becomes a keyframe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.compiling.function import compiled
from vo.config import KeyframeConfig
from vo.types import Floats


class Change(NamedTuple):
    """What is different from the last keyframe.

    Attributes:
        tracked: landmarks tracked now.
        last_tracked: landmarks of the last keyframe.
        parallax_rad: median angle between the rays to landmarks, now and at the last keyframe.
        elapsed_s: since the last keyframe.
    """

    tracked: int
    last_tracked: int
    parallax_rad: float
    elapsed_s: float


def needs_keyframe(change: Change, config: KeyframeConfig) -> bool:
    """Whether the map should be extended here."""
    tracked, last_tracked, parallax_rad, elapsed_s = change
    if tracked < config.min_tracked_share * last_tracked:
        return True
    if parallax_rad > np.deg2rad(config.min_parallax_deg):
        return True
    moving = parallax_rad > 0.2 * np.deg2rad(config.min_parallax_deg)
    return moving and (elapsed_s >= config.max_gap_s or tracked < config.min_tracked)


def median_parallax(points: Floats, first_centre: Floats, second_centre: Floats) -> float:
    """Median angle (rad) at which points (N, 3) see the two camera centres; 0 without points."""
    if len(points) == 0:
        return 0.0
    return float(_median_parallax(np.ascontiguousarray(points), first_centre, second_centre))


@compiled
def _median_parallax(points, first, second):  # type: ignore[no-untyped-def]
    angles = np.empty(len(points))
    for n in range(len(points)):
        ax, ay, az = points[n, 0] - first[0], points[n, 1] - first[1], points[n, 2] - first[2]
        bx, by, bz = points[n, 0] - second[0], points[n, 1] - second[1], points[n, 2] - second[2]
        lengths = np.sqrt(ax * ax + ay * ay + az * az) * np.sqrt(bx * bx + by * by + bz * bz)
        cosine = (ax * bx + ay * by + az * bz) / max(lengths, 1e-12)
        angles[n] = np.arccos(min(max(cosine, -1.0), 1.0))
    return np.median(angles)
