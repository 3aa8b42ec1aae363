"""Laps in both directions as one closed route, with U-turns between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_synth.recipe import LapName
from vo.base.types import Floats


def route_of_laps(waypoints: Floats, laps: Sequence[LapName], aside_m: float) -> Floats:
    """The corners (K, 2) of a closed route of several laps, each forward or in reverse.

    Laps change their direction by a U-turn to the left in the middle of the first side, where the
    route starts.

    `waypoints`: (K, 2) corners of one lap. `laps`: directions, one after the other; none for one
    forward lap. `aside_m`: distance of the laps in reverse from the forward ones, to the left of
    these.
    """
    corners = np.asarray(waypoints, dtype=np.float64)
    if not laps:
        return corners
    ahead = _directions(corners)[0]
    left = aside_m * np.array([-ahead[1], ahead[0]])
    middle, past = 0.5 * (corners[0] + corners[1]), 0.5 * aside_m * ahead
    pieces: dict[LapName, Floats] = {
        "forward": np.roll(corners, -1, axis=0),
        "reverse": np.roll(_beside(corners, aside_m)[::-1], 1, axis=0),
    }
    u_turns: dict[LapName, Floats] = {
        "forward": np.array([middle + past, middle + past + left]),
        "reverse": np.array([middle - past + left, middle - past]),
    }
    parts = []
    for lap, following in zip(laps, (*laps[1:], laps[0]), strict=True):
        parts.append(pieces[lap])
        if following != lap:
            parts.append(u_turns[lap])
    # A route starts between its first two corners.
    return np.roll(np.concatenate(parts), 1, axis=0)


def _directions(corners: Floats) -> Floats:
    """Directions (K, 2) of the sides, each from a corner to the next."""
    sides = np.roll(corners, -1, axis=0) - corners
    return np.asarray(sides / np.linalg.norm(sides, axis=1, keepdims=True))


def _beside(corners: Floats, left_m: float) -> Floats:
    """The corners (K, 2) of a parallel route to the left."""
    ahead = _directions(corners)
    after = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    before = np.roll(after, 1, axis=0)
    along = 1.0 + (before * after).sum(axis=1, keepdims=True)
    return np.asarray(corners + left_m * (before + after) / along)
