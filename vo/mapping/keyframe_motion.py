"""Uncertainty of the motion between keyframes."""

from __future__ import annotations

import numpy as np

from vo.geometry.transforms import adjoint, inverse
from vo.mapping.keyframe import Keyframe
from vo.types import Floats

# Standard deviations of the motion since the keyframe before where the window does not give them:
# radians, and fractions of the distance.
_SIGMA_RAD, _SIGMA_RATIO = 0.02, 0.1


def motion_covariance(before: Keyframe | None, keyframe: Keyframe) -> Floats:
    """(6, 6) of the motion from one keyframe to the next of its segment, in the frame of the next.

    Both are relative to the first of the segment: the error of the motion is
    xi - Ad(next_from_before) xi_before, where the two errors are correlated. Zero for the first
    keyframe of a segment; a rough guess where the window has not determined it.
    """
    if before is None or before.frame.segment != keyframe.frame.segment:
        return np.zeros((6, 6))
    next_from_before = inverse(keyframe.world_from_cam) @ before.world_from_cam
    cross = keyframe.cross_covariance.get(before.id)
    if keyframe.covariance is None or before.covariance is None or cross is None:
        length = float(np.linalg.norm(next_from_before[:3, 3]))
        return np.diag([_SIGMA_RAD**2] * 3 + [max(_SIGMA_RATIO * length, 1e-3) ** 2] * 3)
    moved = adjoint(next_from_before)
    shared = cross @ moved.T
    covariance = keyframe.covariance + moved @ before.covariance @ moved.T - shared - shared.T
    # Differences of large numbers: no direction may come out as certain, or worse.
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    floor = max(1e-6 * float(values[-1]), 1e-14)
    return np.asarray((vectors * np.maximum(values, floor)) @ vectors.T)
