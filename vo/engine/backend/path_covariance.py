"""Covariance of the map's keyframes, relative to the first of their segment."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats
from vo.engine.backend.covariance import propagated
from vo.engine.backend.solution import WindowSolution
from vo.engine.mapping.keyframe import Keyframe


def update_covariances(keyframes: tuple[Keyframe, ...], solution: WindowSolution) -> None:
    """Update covariances and cross-covariances of the keyframes that a window moved."""
    count = len(keyframes)
    joint = propagated(solution.information, solution.held, _joint(keyframes))
    blocks = np.ascontiguousarray(joint.reshape(count, 6, count, 6).swapaxes(1, 2))
    known = np.asarray(np.isfinite(blocks).all(axis=(2, 3)))
    for k, keyframe in enumerate(keyframes):
        if solution.held[k] and keyframe.covariance is not None:
            continue
        keyframe.covariance = blocks[k, k] if known[k, k] else None
        keyframe.cross_covariance = {keyframes[j].id: blocks[k, j] for j in range(k) if known[k, j]}


def _joint(keyframes: tuple[Keyframe, ...]) -> Floats:
    """(6 K, 6 K) joint covariance; NaN on the diagonal where it is unknown."""
    count = len(keyframes)
    blocks = np.zeros((count, count, 6, 6))
    for k, keyframe in enumerate(keyframes):
        blocks[k, k] = np.nan if keyframe.covariance is None else keyframe.covariance
        for j, other in enumerate(keyframes[:k]):
            cross = keyframe.cross_covariance.get(other.id)
            if cross is not None:
                blocks[k, j], blocks[j, k] = cross, cross.T
    return blocks.swapaxes(1, 2).reshape(6 * count, 6 * count)
