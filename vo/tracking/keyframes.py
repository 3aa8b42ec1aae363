"""When a frame becomes a keyframe."""

from __future__ import annotations

import numpy as np

from vo.config import KeyframeConfig
from vo.types import Floats


def needs_keyframe(
    tracked: int, last_tracked: int, parallax_rad: float, elapsed_s: float, config: KeyframeConfig
) -> bool:
    """Whether the map should be extended here.

    Args:
        tracked: landmarks tracked now.
        last_tracked: landmarks of the last keyframe.
        parallax_rad: median angle between the rays to landmarks, now and at the last keyframe.
        elapsed_s: since the last keyframe.
        config: the limits.
    """
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
    a, b = points - first_centre, points - second_centre
    cosine = np.sum(a * b, axis=1) / np.maximum(
        np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-12
    )
    return float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))))
