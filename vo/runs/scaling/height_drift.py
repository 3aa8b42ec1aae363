"""Heights of a receiver that drift in time, as while it still converges, unlike those of the path.

Receivers know their height worse than their place. Where the speed changes or the camera turns, a
drift in time is no slope of the path; on a straight road at constant speed it looks like one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import so3_exp
from vo.base.types import Floats, Ints
from vo.runs.scaling.correlation import correlated_variance
from vo.runs.scaling.fit import PositionFit
from vo.runs.scaling.positions import Positions
from vo.runs.scaling.timed_fit import associate

_TIMES = (np.inf, 0.5, 0.2, 0.1)  # in which an error falls to 1/e, relative to the duration
_ROUNDS = 12
_HUBER, _MEDIAN_OF_NORM = 2.8, 1.538  # as in the fit of positions
_UP = np.array([0.0, 0.0, 1.0])


class HeightDrift(NamedTuple):
    """What a drift of the heights would explain.

    Attributes:
        positions: without it; the last heights stay.
        metres: by which the first heights are wrong.
        seconds: duration of the path.
        slope_sigma: relative standard deviation of the scale beside such a drift.
    """

    positions: Positions
    metres: float
    seconds: float
    slope_sigma: float


def fit_height_drift(
    given: Positions, stamps_ns: Ints, xyz: Floats, plain: tuple[PositionFit, float]
) -> HeightDrift | None:
    """The drift, linear or towards a limit, that brings positions closest to a path.

    `xyz`: (N, 3) of the sensor by the path; `plain`: the fit without a drift. None if there are no
    positions.
    """
    between, fraction, rows = associate(stamps_ns, given.shifted(-round(1e9 * plain[1])).stamps_ns)
    if len(rows) == 0:
        return None
    source = xyz[between] + fraction[:, None] * (xyz[between + 1] - xyz[between])
    times_s = 1e-9 * (given.stamps_ns - given.stamps_ns[rows[0]])
    seconds = max(float(times_s[rows[-1]]), 1e-9)
    part = np.clip(times_s / seconds, 0.0, 1.0)
    best: tuple[float, float, float, Floats] | None = None
    for time in _TIMES:
        shape = 1.0 - part if np.isinf(time) else np.exp(-part / time) - np.exp(-1.0 / time)
        shape = shape / shape.max()
        found = _fitted(times_s[rows], source, given.xyz[rows], shape[rows], plain[0])
        if best is None or found[0] < best[0]:
            best = *found, shape
    assert best is not None
    _, metres, sigma, shape = best
    corrected = replace(given, xyz=given.xyz - metres * shape[:, None] * _UP)
    return HeightDrift(corrected, metres, seconds, sigma)


def _fitted(
    times_s: Floats, source: Floats, target: Floats, shape: Floats, plain: PositionFit
) -> tuple[float, float, float]:
    """Similarity and drift together (IRLS): squared residual, drift, relative scale sigma."""
    scale, rotation, shift = plain.scale, plain.rotation, plain.translation
    drift = shape[:, None] * _UP
    metres = 0.0
    middle = source.mean(axis=0)
    shift = shift + scale * rotation @ middle
    for _ in range(_ROUNDS):
        moved = scale * (source - middle) @ rotation.T
        columns = [moved, *(np.cross(unit, moved) for unit in np.eye(3))]
        columns += [np.tile(unit, (len(moved), 1)) for unit in np.eye(3)]
        design = np.stack([*columns, drift], axis=2)
        residual = target - moved - shift - metres * drift
        length = np.linalg.norm(residual, axis=1)
        sigma = max(float(np.median(length)) / _MEDIAN_OF_NORM, 1e-9)
        root = np.sqrt(np.minimum(1.0, _HUBER * sigma / np.maximum(length, 1e-300)))
        inverse = np.linalg.pinv((root[:, None, None] * design).reshape(-1, 8))
        step = inverse @ (root[:, None] * residual).ravel()
        scale *= float(np.exp(np.clip(step[0], -0.5, 0.5)))
        rotation, shift, metres = so3_exp(step[1:4]) @ rotation, shift + step[4:7], metres + step[7]
    influence = (inverse[0] * np.repeat(root, 3)).reshape(-1, 3)
    variance, _ = correlated_variance(times_s, influence, [*columns, drift], residual)
    robust = root**2 * length**2
    return float(robust.sum()), float(metres), float(np.sqrt(variance))
