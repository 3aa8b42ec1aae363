"""Faults of positions, tried as explanations of how they differ from a path.

A fault is believed where the positions that it would make of the path fit much better than the
path itself: a receiver that smooths, exchanged columns, a mirrored or stretched frame, heights that
drift. On a straight road at constant speed none of them shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.geodesy import enu_from_geodetic, geodetic_from_enu
from vo.base.types import Floats, Ints
from vo.runs.scaling.fit import PositionFit
from vo.runs.scaling.height_drift import find_height_drift
from vo.runs.scaling.positions import Positions
from vo.runs.scaling.timed_fit import fit_in_time

# Ratio of squared residuals at which a fault is believed, and what is added to it by chance,
# divided by the number of positions. Of clean positions it is at most 1.7, in time 1.1.
_IN_SPACE = (2.0, 20.0)
_IN_TIME = (1.3, 6.0)
_POSSIBLE = (1.4, 10.0)  # exchanged columns can't be excluded
_SAME = 1.4
_SMOOTHED_S = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
_LATE_S, _LATE = 1.0, 1.6  # the fault need not fit better than clocks that differ by so much
_STRETCHED = (1.25, 1.5, 2.0)
_PATH_ERROR = 0.002  # of the path, relative to its extent: smaller differences say nothing
_REFUSED = 25.0 / 3.0  # square of a refused residual along one axis, in variances
_SHIFTS = 3  # refused positions that a jump counts as
_SAME_ROWS = 0.9
_MAX_OFFSET_S = 0.5  # between clocks, by a fault

EXCHANGED = "latitude and longitude are exchanged"


class Explanation(NamedTuple):
    """What explains the positions best.

    Attributes:
        cause: a sentence, empty if they fit as they are.
        fit: with the offset of the clocks, by which the positions can be used; None if they can't.
        positions: those of the fit.
        slope_sigma: relative standard deviation of the scale, by heights that nothing confirms.
    """

    cause: str
    fit: tuple[PositionFit, float] | None
    positions: Positions
    slope_sigma: float = 0.0


class _Alternative(NamedTuple):
    cause: str
    positions: Positions
    xyz: Floats
    limit: tuple[float, float] = _IN_SPACE
    is_corrected: bool = False  # its positions can be used


def explain(
    given: Positions,
    stamps_ns: Ints,
    xyz: Floats,
    arms: Floats,
    plain: tuple[PositionFit, float],
) -> Explanation:
    """Compare the fit of positions with those that their faults would explain.

    Args: as for `fit_in_time`, and `plain`: its result.
    """
    if plain[0].resolution_m > plain[0].noise_m:
        return Explanation("", plain, given)  # the shape of rounded positions says nothing
    count = len(plain[0].used)
    sensor = xyz + arms / plain[0].scale
    flat = _fit_flat(given, stamps_ns, sensor)
    best, best_ratio = Explanation("", plain, given), 1.0
    for tried in _alternatives(given, stamps_ns, sensor, flat):
        found = _fit(tried.positions, stamps_ns, tried.xyz)
        if isinstance(found, str) or not _is_comparable(found, plain):
            continue
        ratio = _ratio(plain[0], found[0])
        if tried.limit == _IN_TIME and abs(plain[1]) > _LATE_S and abs(found[1]) <= _MAX_OFFSET_S:
            ratio *= _LATE
        if tried.cause == EXCHANGED:  # heights alone must not decide it
            other = _fit_flat(tried.positions, stamps_ns, sensor)
            ratio = min(ratio, _ratio(flat[0], other[0]) if flat and other else 0.0)
        if ratio > max(best_ratio, tried.limit[0] + tried.limit[1] / count):
            best, best_ratio = Explanation(tried.cause, None, given), ratio
            chosen = tried
    if best.cause and chosen.is_corrected and best_ratio > _IN_SPACE[0] + _IN_SPACE[1] / count:
        exact = fit_in_time(chosen.positions, stamps_ns, xyz, arms, is_metric=False)
        if isinstance(exact, str):
            return best
        slope = (
            abs(flat[0].scale / exact[0].scale - 1.0) if flat and best.cause != EXCHANGED else 0.0
        )
        return Explanation(best.cause, exact, chosen.positions, slope)
    if best.cause == EXCHANGED:
        return best._replace(cause=f"it can't be excluded that {EXCHANGED}")
    if best.cause or flat is None or _ratio(plain[0], flat[0]) < 1.0 / _SAME:
        return best
    return best._replace(slope_sigma=abs(flat[0].scale / plain[0].scale - 1.0))


def _is_comparable(found: tuple[PositionFit, float], plain: tuple[PositionFit, float]) -> bool:
    """Whether a fit is at about the same times as the plain one, or those of the clock."""
    offset_s = min(abs(found[1]), abs(found[1] - plain[1]))
    return offset_s <= _MAX_OFFSET_S and len(found[0].used) >= _SAME_ROWS * len(plain[0].used)


def _fit(given: Positions, stamps_ns: Ints, xyz: Floats) -> tuple[PositionFit, float] | str:
    return fit_in_time(given, stamps_ns, xyz, np.zeros_like(xyz), is_metric=False)


def _fit_flat(given: Positions, stamps_ns: Ints, xyz: Floats) -> tuple[PositionFit, float] | None:
    """The fit to positions without heights; None if it is unknown what the heights are."""
    if given.origin is None:
        return None
    found = _fit(replace(given, xyz=given.xyz * (1.0, 1.0, 0.0)), stamps_ns, xyz)
    return None if isinstance(found, str) else found


def _alternatives(
    given: Positions, stamps_ns: Ints, xyz: Floats, flat: tuple[PositionFit, float] | None
) -> Iterator[_Alternative]:
    if given.origin is not None:
        exchanged = _exchanged(given, given.origin)
        yield _Alternative(EXCHANGED, exchanged, xyz, _POSSIBLE, is_corrected=True)
    error_m = _PATH_ERROR * flat[0].extent_m if flat else 0.0
    drift = find_height_drift(given, stamps_ns, xyz, flat, error_m) if flat else None
    if drift and drift.ratio > _IN_SPACE[0] + _IN_SPACE[1] / len(xyz):
        cause = f"heights drift by {-drift.metres:+.2g} m in {drift.seconds:.2g} s"
        yield _Alternative(cause, drift.positions, xyz, is_corrected=True)
    for seconds in _SMOOTHED_S:
        cause = (
            "they move at other speeds than the camera at the same time, as those of a receiver "
            f"that smooths over about {seconds:g} s"
        )
        yield _Alternative(cause, given, _smoothed(stamps_ns, xyz, seconds), _IN_TIME)
    mirrored = "they are mirrored: two columns are exchanged, or an axis has the wrong sign"
    yield _Alternative(mirrored, replace(given, xyz=given.xyz * (1.0, 1.0, -1.0)), xyz)
    for factor in _STRETCHED:
        cause = f"they have another shape than the path, {factor:g} times as long in one direction"
        for factors in ((factor, 1.0, 1.0), (1.0, factor, 1.0)):
            yield _Alternative(cause, replace(given, xyz=given.xyz * factors), xyz)


def _exchanged(given: Positions, origin: Floats) -> Positions:
    geodetic = geodetic_from_enu(given.xyz, origin)[:, [1, 0, 2]]
    new_origin = origin[[1, 0, 2]]
    return replace(given, xyz=enu_from_geodetic(geodetic, new_origin), origin=new_origin)


def _smoothed(stamps_ns: Ints, xyz: Floats, seconds: float) -> Floats:
    """A path behind a low-pass filter of first order that has stood still before."""
    smoothed = np.array(xyz)
    weights = -np.expm1(-1e-9 * np.diff(stamps_ns) / seconds)
    for row, weight in enumerate(weights.tolist(), start=1):
        smoothed[row] = smoothed[row - 1] + weight * (xyz[row] - smoothed[row - 1])
    return smoothed


def _ratio(plain: PositionFit, other: PositionFit) -> float:
    """Squared residuals of one fit relative to those of another, with what they refuse."""
    variances = [
        fit.noise_m**2 + (_PATH_ERROR * fit.extent_m) ** 2 + fit.resolution_m**2
        for fit in (plain, other)
    ]
    return _cost(plain, variances[0], min(variances)) / _cost(other, variances[1], min(variances))


def _cost(fit: PositionFit, variance: float, smallest: float) -> float:
    used = float(fit.used.mean())
    refused = 1.0 - used + _SHIFTS * fit.jumps / len(fit.used)
    return used * variance + _REFUSED * refused * smallest
