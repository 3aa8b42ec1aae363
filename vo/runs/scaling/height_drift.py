"""Heights of a receiver that drift in time, as while it still converges, unlike those of the path.

Receivers know their height worse than their place. Where the speed changes or the camera turns, a
drift in time is no slope of the path; on a straight road at constant speed it looks like one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats, Ints
from vo.runs.scaling.fit import PositionFit
from vo.runs.scaling.positions import Positions
from vo.runs.scaling.timed_fit import associate

_TIMES = (np.inf, 0.5, 0.2, 0.1)  # in which an error falls to 1/e, relative to the duration
_UP = np.array([0.0, 0.0, 1.0])


class HeightDrift(NamedTuple):
    """What a drift of the heights would explain.

    Attributes:
        positions: without it; the last heights stay.
        metres: by which the first heights are wrong.
        seconds: duration of the path.
        ratio: squared residuals of the heights without and with it.
    """

    positions: Positions
    metres: float
    seconds: float
    ratio: float


def find_height_drift(
    given: Positions,
    stamps_ns: Ints,
    xyz: Floats,
    flat: tuple[PositionFit, float],
    path_error_m: float,
) -> HeightDrift | None:
    """The drift, linear or towards a limit, that explains heights best, beside a tilted path.

    One linear least squares for each. `xyz`: (N, 3) of the sensor by the path; `flat`: its fit to
    positions without heights; `path_error_m`: heights of the path are wrong by as much.
    """
    fit, offset_s = flat
    shifted = given.shifted(-round(1e9 * offset_s))
    between, fraction, rows = associate(stamps_ns, shifted.stamps_ns)
    if len(rows) != len(fit.used) or fit.jumps:
        return None
    source = xyz[between] + fraction[:, None] * (xyz[between + 1] - xyz[between])
    moved = fit.scale * (source - source.mean(axis=0)) @ fit.rotation.T
    times_s = 1e-9 * (given.stamps_ns - given.stamps_ns[rows[0]])
    seconds = max(float(times_s[rows[-1]]), 1e-9)
    part = np.clip(times_s / seconds, 0.0, 1.0)
    tilt = np.column_stack([np.ones(len(rows)), moved[:, :2]])[fit.used]
    heights = (given.xyz[rows, 2] - moved[:, 2])[fit.used]
    noise = path_error_m**2 * len(heights)
    without, _ = _least_squares(tilt, heights)
    best: HeightDrift | None = None
    for time in _TIMES:
        shape = 1.0 - part if np.isinf(time) else np.exp(-part / time) - np.exp(-1.0 / time)
        shape = shape / shape.max()
        left, found = _least_squares(np.column_stack([tilt, shape[rows][fit.used]]), heights)
        ratio = (without + noise) / (left + noise)
        if best is None or ratio > best.ratio:
            metres = float(found[-1])
            corrected = replace(given, xyz=given.xyz - metres * shape[:, None] * _UP)
            best = HeightDrift(corrected, metres, seconds, ratio)
    return best


def _least_squares(design: Floats, values: Floats) -> tuple[float, Floats]:
    """Squared residual and solution."""
    found = np.linalg.lstsq(design, values, rcond=1e-9)[0]
    return float(((values - design @ found) ** 2).sum()), np.asarray(found, np.float64)
