"""Covariance of the map's keyframes, relative to the first of their segment."""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools, Floats
from vo.engine.backend.solution import WindowSolution
from vo.engine.mapping.keyframe import Keyframe


def update_covariances(keyframes: tuple[Keyframe, ...], solution: WindowSolution) -> None:
    """Update covariances and cross-covariances of the keyframes that a window moved."""
    count = len(keyframes)
    joint = propagated(solution.information, solution.held, _joint(keyframes, solution.held))
    blocks = np.ascontiguousarray(joint.reshape(count, 6, count, 6).swapaxes(1, 2))
    known = np.asarray(np.isfinite(blocks).all(axis=(2, 3)))
    for k, keyframe in enumerate(keyframes):
        if solution.held[k] and keyframe.covariance is not None:
            continue
        keyframe.covariance = blocks[k, k] if known[k, k] else None
        keyframe.cross_covariance = {keyframes[j].id: blocks[k, j] for j in range(k) if known[k, j]}


def _joint(keyframes: tuple[Keyframe, ...], held: Bools) -> Floats:
    """(6 K, 6 K) joint covariance of those that are held; NaN on the diagonal where unknown."""
    count = len(keyframes)
    blocks = np.zeros((count, count, 6, 6))
    fixed = [k for k in range(count) if held[k]]
    for n, k in enumerate(fixed):
        keyframe = keyframes[k]
        blocks[k, k] = np.nan if keyframe.covariance is None else keyframe.covariance
        for j in fixed[:n]:
            cross = keyframe.cross_covariance.get(keyframes[j].id)
            if cross is not None:
                blocks[k, j], blocks[j, k] = cross, cross.T
    return blocks.swapaxes(1, 2).reshape(6 * count, 6 * count)


def propagated(information: Floats, held: Bools, known: Floats) -> Floats:
    """(6 K, 6 K) joint covariance of a window's K poses; NaN for those that are not determined.

    The held poses have errors too, which the others share:
    error_free = -I_ff^-1 I_fh error_held + noise, noise ~ N(0, I_ff^-1).

    Args:
        information: (6 K, 6 K) of the window on its poses; 0 for poses it does not determine.
        held: (K,) poses that stayed where they were.
        known: (6 K, 6 K) joint covariance of the held ones, NaN where unknown; entries of the
            others are ignored.

    Source: Barfoot, "State Estimation for Robotics", 2017, sec. 2.2.3 (a joint density is that of
    one part times that of the other given the first).
    """
    result = np.full_like(known, np.nan)
    anchored = held & np.isfinite(np.diag(known)).reshape(-1, 6).all(axis=1)
    free = ~anchored & (np.diag(information).reshape(-1, 6) > 0).all(axis=1)
    h, f = np.flatnonzero(np.repeat(anchored, 6)), np.flatnonzero(np.repeat(free, 6))
    of_held = known.take(h, 0).take(h, 1)
    result[h[:, None], h] = of_held
    of_free = information.take(f, 0)
    own_information = of_free.take(f, 1)
    try:
        np.linalg.cholesky(own_information)
        noise = np.linalg.inv(own_information)
    except np.linalg.LinAlgError:  # not positive definite: some pose is not determined
        return result
    if len(h) == 0:
        return result
    gain = -noise @ of_free.take(h, 1)
    shared = gain @ of_held
    own = shared @ gain.T + noise
    result[f[:, None], h], result[h[:, None], f] = shared, shared.T
    # Rounding must not add up: an asymmetry would grow with every window.
    result[f[:, None], f] = 0.5 * (own + own.T)
    return result
