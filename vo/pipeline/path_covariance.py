"""How certain the map's keyframes are, against the first of their segment."""

from __future__ import annotations

import numpy as np

from vo.mapping.map import Keyframe
from vo.smoothing.covariance import propagated
from vo.smoothing.solution import WindowSolution
from vo.types import Floats


def update_covariances(keyframes: tuple[Keyframe, ...], solution: WindowSolution) -> None:
    """Give the keyframes that a window moved their covariances, also those with one another."""
    joint = propagated(solution.information, solution.held, _joint(keyframes))
    for k, keyframe in enumerate(keyframes):
        if solution.held[k] and keyframe.covariance is not None:
            continue
        keyframe.covariance = _block(joint, k, k)
        keyframe.shared = {}
        for j in range(k):
            shared = _block(joint, k, j)
            if shared is not None:
                keyframe.shared[keyframes[j].id] = shared


def _joint(keyframes: tuple[Keyframe, ...]) -> Floats:
    """(6 K, 6 K) covariances as they are known; NaN on the diagonal where they are not."""
    joint = np.zeros((6 * len(keyframes), 6 * len(keyframes)))
    for k, keyframe in enumerate(keyframes):
        rows = slice(6 * k, 6 * k + 6)
        joint[rows, rows] = np.nan if keyframe.covariance is None else keyframe.covariance
        for j, other in enumerate(keyframes[:k]):
            if other.id in keyframe.shared:
                columns = slice(6 * j, 6 * j + 6)
                joint[rows, columns] = keyframe.shared[other.id]
                joint[columns, rows] = keyframe.shared[other.id].T
    return joint


def _block(joint: Floats, row: int, column: int) -> Floats | None:
    block = joint[6 * row : 6 * row + 6, 6 * column : 6 * column + 6]
    return block.copy() if np.isfinite(block).all() else None
