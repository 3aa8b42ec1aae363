"""Uncertainty of the motion between keyframes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vo.base.geometry.transforms import adjoint, inverse
from vo.base.types import Floats
from vo.engine.mapping.keyframe import Keyframe

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
    return _determined(next_from_before, keyframe.covariance, before.covariance, cross)


def motion_covariances(keyframes: Sequence[Keyframe]) -> list[Floats]:
    """The same of all motions between n keyframes, n - 1 of them."""
    known = [
        n
        for n in range(1, len(keyframes))
        if keyframes[n].covariance is not None
        and keyframes[n - 1].covariance is not None
        and keyframes[n].frame.segment == keyframes[n - 1].frame.segment
        and keyframes[n - 1].id in keyframes[n].cross_covariance
    ]
    found: dict[int, Floats] = {}
    if known:
        pairs = [(keyframes[n - 1], keyframes[n]) for n in known]
        poses = np.array([[b.world_from_cam, a.world_from_cam] for b, a in pairs])
        cross = np.array([a.cross_covariance[b.id] for b, a in pairs])
        both = np.array([[b.covariance, a.covariance] for b, a in pairs], np.float64)
        motions = inverse(poses[:, 1]) @ poses[:, 0]
        found = dict(zip(known, _determined(motions, both[:, 1], both[:, 0], cross), strict=True))
    return [
        found[n] if n in found else motion_covariance(keyframes[n - 1], keyframes[n])
        for n in range(1, len(keyframes))
    ]


def _determined(next_from_before: Floats, after: Floats, before: Floats, cross: Floats) -> Floats:
    """Covariances (..., 6, 6) of motions whose ends have covariances and a cross-covariance."""
    moved = adjoint(next_from_before)
    back = np.swapaxes(moved, -1, -2)
    shared = cross @ back
    covariance = after + moved @ before @ back - shared - np.swapaxes(shared, -1, -2)
    # Differences of large numbers: no direction may come out as certain, or worse.
    values, vectors = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    floor = np.maximum(1e-6 * values[..., -1:], 1e-14)
    scaled = vectors * np.maximum(values, floor)[..., None, :]
    return np.asarray(scaled @ np.swapaxes(vectors, -1, -2))
