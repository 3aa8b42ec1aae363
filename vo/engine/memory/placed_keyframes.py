"""Keyframes that the pose graph has placed, by their worlds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from vo.engine.places.records import Loop, PlacedKeyframes
from vo.engine.trajectory.map_frame import scaled_covariance


def of_worlds(placed: PlacedKeyframes, loops: Iterable[Loop]) -> PlacedKeyframes:
    """The keyframes of worlds with loops; others stay where they are, to the last bit."""
    world_of = dict(zip(placed.keys, placed.world.tolist(), strict=True))
    worlds = {world_of[loop.later] for loop in loops if loop.later in world_of}
    return placed.rows(np.flatnonzero(np.isin(placed.world, list(worlds))))


def with_adjusted(placed: PlacedKeyframes, adjusted: Sequence[PlacedKeyframes]) -> PlacedKeyframes:
    """Placed keyframes, with the poses and scales of those that were adjusted afterwards."""
    world_from_cam, scale = placed.world_from_cam.copy(), placed.scale.copy()
    row = {key: n for n, key in enumerate(placed.keys)}
    for each in adjusted:
        for n, key in enumerate(each.keys):
            if key in row:
                world_from_cam[row[key]], scale[row[key]] = each.world_from_cam[n], each.scale[n]
    return replace(placed, world_from_cam=world_from_cam, scale=scale)


def scaled_worlds(placed: PlacedKeyframes, factor_of: Mapping[int, float]) -> PlacedKeyframes:
    """Placed keyframes, the worlds of some rows multiplied by a factor."""
    factor = np.ones(len(placed.keys))
    for row, value in factor_of.items():
        factor[placed.world == placed.world[row]] = value
    if (factor == 1.0).all():
        return placed
    world_from_cam = placed.world_from_cam.copy()
    world_from_cam[:, :3, 3] *= factor[:, None]
    covariance = np.stack(
        [scaled_covariance(c, f) for c, f in zip(placed.covariance, factor, strict=True)]
    )
    return replace(
        placed,
        world_from_cam=world_from_cam,
        scale=placed.scale * factor,
        covariance=covariance,
    )
