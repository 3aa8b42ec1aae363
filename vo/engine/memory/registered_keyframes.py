"""Keyframes that the pose graph has placed, by their worlds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from vo.engine.places.records import Loop, RegisteredKeyframes
from vo.engine.trajectory.map_frame import scaled_covariance


def of_worlds(registered: RegisteredKeyframes, loops: Iterable[Loop]) -> RegisteredKeyframes:
    """The keyframes of worlds with loops; others stay where they are, to the last bit."""
    world_of = dict(zip(registered.keys, registered.world.tolist(), strict=True))
    worlds = {world_of[loop.later] for loop in loops if loop.later in world_of}
    return registered.rows(np.flatnonzero(np.isin(registered.world, list(worlds))))


def with_adjusted(
    registered: RegisteredKeyframes, adjusted: Sequence[RegisteredKeyframes]
) -> RegisteredKeyframes:
    """Registered keyframes, with the poses and scales of those that were adjusted afterwards."""
    world_from_cam, scale = registered.world_from_cam.copy(), registered.scale.copy()
    row = {key: n for n, key in enumerate(registered.keys)}
    for each in adjusted:
        for n, key in enumerate(each.keys):
            if key in row:
                world_from_cam[row[key]], scale[row[key]] = each.world_from_cam[n], each.scale[n]
    return replace(registered, world_from_cam=world_from_cam, scale=scale)


def scaled_worlds(
    registered: RegisteredKeyframes, factor_of: Mapping[int, float]
) -> RegisteredKeyframes:
    """Registered keyframes, the worlds of some rows multiplied by a factor."""
    factor = np.ones(len(registered.keys))
    for row, value in factor_of.items():
        factor[registered.world == registered.world[row]] = value
    if (factor == 1.0).all():
        return registered
    world_from_cam = registered.world_from_cam.copy()
    world_from_cam[:, :3, 3] *= factor[:, None]
    covariance = np.stack(
        [scaled_covariance(c, f) for c, f in zip(registered.covariance, factor, strict=True)]
    )
    return replace(
        registered,
        world_from_cam=world_from_cam,
        scale=registered.scale * factor,
        covariance=covariance,
    )
