"""Kidnapping: the camera is carried elsewhere and back, without images of the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.recipe import Effects
from vo.base.types import Bools, Floats

_AWAY = 0.25  # fraction of the recording that is spent elsewhere
_FIRST = 0.45  # of each part of the recording, before the camera is carried away
_DRAWS = 32
_SEED_ELSEWHERE = 76


@dataclass(frozen=True, eq=False)
class Kidnapping:
    """Where on the path the frames of a recording are."""

    path_s: Floats  # (F,) time on the path of each frame; it jumps when the camera is carried
    black: Bools  # (F,) black frames


def path_seconds(effects: Effects, seconds: float) -> float:
    """Length of the path, which stands still while the camera is elsewhere."""
    return seconds * (1.0 - _AWAY) if effects.kidnap > 0 else seconds


def kidnap(
    effects: Effects,
    times_s: Floats,
    seconds: float,
    position_at: Callable[[Floats], Floats],
    seed: int,
) -> Kidnapping:
    """Carry the camera `effects.kidnap` times elsewhere on its path and back.

    The frames elsewhere are a quarter of the recording. It goes on where it was taken from.

    `effects`: how often, and for how many black frames each way. `times_s`: (F,) times of the
    frames since the start. `position_at`: positions (N, 3) on the path at times (N,). `seed`: of
    the choice of the other places: the farthest of several.
    """
    path_s, black = times_s.copy(), np.zeros(len(times_s), np.bool_)
    if effects.kidnap == 0:
        return Kidnapping(path_s, black)
    rng = np.random.default_rng([seed, _SEED_ELSEWHERE])
    away_s = _AWAY * seconds / effects.kidnap
    for k in range(effects.kidnap):
        taken_s = (k + _FIRST) * seconds / effects.kidnap
        from_s = taken_s - k * away_s
        draws = rng.uniform(0.0, path_seconds(effects, seconds) - away_s, _DRAWS)
        apart = np.linalg.norm(position_at(draws) - position_at(np.array([from_s])), axis=1)
        elsewhere_s = float(draws[np.argmax(apart)])
        away = (times_s >= taken_s) & (times_s < taken_s + away_s)
        after = times_s >= taken_s + away_s
        path_s[away] = times_s[away] - taken_s + elsewhere_s
        path_s[after] = times_s[after] - (k + 1) * away_s
        for first in (np.flatnonzero(away)[:1], np.flatnonzero(after)[:1]):
            for index in first:
                black[index : index + effects.kidnap_black] = True
    return Kidnapping(path_s, black)
