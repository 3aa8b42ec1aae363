"""Changes of the light on a scene over time."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats

_WANDER = 1.3
_PERIODS_S = (7.0, 11.0, 19.0)
_STEP = 1.8
_STEP_SPREAD = 0.2

_DARK = 0.12
_FIRST_DARK_S = (2.0, 4.0)
_DARK_LENGTH_S = (1.8, 2.2)
_DARK_EVERY_S = (7.0, 9.0)
_RAMP_S = 0.2

_SEED_WANDER, _SEED_STEPS, _SEED_DARK = 73, 74, 75


def drifting_light(times_s: Floats, strength: float, seed: int) -> Floats:
    """Light (F,) that drifts by up to 30 % at strength 1, with one or two sudden steps.

    It is 1 at time 0. A step, as of a lamp or at the edge of a shadow, is a factor of about 1.8 at
    strength 1, up or down; a second step has the opposite direction.
    """
    rng = np.random.default_rng([seed, _SEED_WANDER])
    weights = rng.uniform(0.5, 1.0, len(_PERIODS_S)) * rng.choice([-1.0, 1.0], len(_PERIODS_S))
    weights /= np.abs(weights).sum()
    periods = np.array(_PERIODS_S) * rng.uniform(0.8, 1.2, len(_PERIODS_S))
    drift = np.sin(2.0 * np.pi * times_s[:, None] / periods) @ weights
    # As powers, so that light stays positive and twice the strength applies each factor twice.
    return np.asarray(_WANDER ** (strength * drift) * _STEP ** (strength * _steps(times_s, seed)))


def dark_intervals(times_s: Floats, strength: float, seed: int) -> Floats:
    """Factor (F,) of the light: 0.12 at strength 1 for about 2 s in every 8 s.

    Transitions take 0.2 s. The first interval starts after 2 s to 4 s.
    """
    rng = np.random.default_rng([seed, _SEED_DARK])
    depth = np.zeros(len(times_s))
    start = rng.uniform(*_FIRST_DARK_S)
    while start < times_s[-1]:
        end = start + rng.uniform(*_DARK_LENGTH_S)
        inside = np.minimum(times_s - start, end - times_s) / _RAMP_S
        depth = np.maximum(depth, _smooth(inside))
        start += rng.uniform(*_DARK_EVERY_S)
    return np.asarray(1.0 - (1.0 - _DARK**strength) * depth)


def _steps(times_s: Floats, seed: int) -> Floats:
    """Exponent (F,) of the factor of the steps: 0 before the first step."""
    rng = np.random.default_rng([seed, _SEED_STEPS])
    count = int(rng.integers(1, 3))
    sign = float(rng.choice([-1.0, 1.0]))
    seconds = float(times_s[-1])
    exponent = np.zeros(len(times_s))
    for i in range(count):
        # One step in each part of the recording, away from its ends.
        at = seconds * (i + rng.uniform(0.3, 0.8)) / count
        size = rng.uniform(1.0 - _STEP_SPREAD, 1.0 + _STEP_SPREAD)
        exponent[times_s >= at] += sign * (-1.0) ** i * size
    return exponent


def _smooth(x: Floats) -> Floats:
    """Smooth step: 3 x² - 2 x³ for x from 0 to 1."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))
