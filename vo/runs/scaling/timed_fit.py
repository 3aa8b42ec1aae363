"""The fit of a path to positions of the same times, and the offset between their clocks."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats, Ints
from vo.runs.scaling.correlation import correlated_variance
from vo.runs.scaling.fit import MIN_POSITIONS, PositionFit, fit_positions
from vo.runs.scaling.positions import Positions

_MAX_GAP_NS = 1_000_000_000  # between poses of the path, over which positions are interpolated
_MIN_OFFSET_S = 0.1  # of clocks, which is corrected and reported
_ACCURATE_OFFSET_S = 0.01  # where the correction ends
_OFFSET_SIGMAS = 4.0
_CLOCK_SIGMA_S = 0.05  # of an offset that is not corrected, at least
_MAX_CLOCK_SIGMA_S = 0.2  # of clocks that are meant to agree
_MIN_DISTINCT = 1e-4  # fraction of the squared speed that nothing else explains
_ARM_ROUNDS = 8


def fit_in_time(
    given: Positions, stamps_ns: Ints, xyz: Floats, arms: Floats, *, is_metric: bool
) -> tuple[PositionFit, float] | str:
    """The fit and the offset of the clocks that was corrected, or why there is none.

    Args:
        given: positions of the other sensor.
        stamps_ns: (N,) of the path.
        xyz: (N, 3) positions of the camera.
        arms: (N, 3) metres from it to the other sensor, in the world of the path.
        is_metric: whether the path is in metres.
    """
    offset_ns, resolution_m = 0, given.resolution_m
    result: PositionFit | None = None
    for _ in range(5):
        moved = given.shifted(offset_ns)
        between, fraction, rows = associate(stamps_ns, moved.stamps_ns)
        if len(rows) < MIN_POSITIONS:
            if result is not None:
                break
            return f"only {len(rows)} positions at times of the path"
        source, arm = (
            each[between] + fraction[:, None] * (each[between + 1] - each[between])
            for each in (xyz, arms)
        )
        sigma = given.sigma_m[rows]
        known = sigma if np.isfinite(sigma).all() and (sigma > 0.0).all() else None
        times_s = 1e-9 * (moved.stamps_ns[rows] - moved.stamps_ns[0])
        xyz_m = given.xyz[rows]
        if is_metric:
            source = source + arm
        fit = fit_positions(
            times_s, source, xyz_m, known, with_scale=not is_metric, resolution_m=resolution_m
        )
        if fit is not None and arm.any() and not is_metric:
            camera = source
            for _ in range(_ARM_ROUNDS):  # the scale gives the arm its length in map units
                source = camera + arm / fit.scale
                fit = fit_positions(times_s, source, xyz_m, known) or fit
        if fit is None:
            return "the path or the positions do not move"
        elapsed = (stamps_ns[between + 1] - stamps_ns[between])[:, None] * 1e-9
        speed = (xyz[between + 1] - xyz[between]) / elapsed
        late_s, sigma_s = _time_offset(fit, times_s, speed, source)
        if not offset_ns and abs(late_s) <= _OFFSET_SIGMAS * sigma_s:
            late_s = 0.0
        result = _with_clock_sigma(fit, speed, source, sigma_s)
        if abs(late_s) < (_ACCURATE_OFFSET_S if offset_ns else _MIN_OFFSET_S):
            break
        offset_ns -= round(1e9 * late_s)
    assert result is not None
    return result, -1e-9 * offset_ns


def associate(stamps_ns: Ints, times_ns: Ints) -> tuple[Ints, Floats, Ints]:
    """Pose before each time, fraction to the next one, and rows of the times between poses."""
    if len(stamps_ns) < 2:
        empty = np.empty(0, np.int64)
        return empty, np.empty(0), empty
    before = np.searchsorted(stamps_ns, times_ns, side="right") - 1
    is_end = times_ns == stamps_ns[-1]
    before[is_end] = len(stamps_ns) - 2
    inside = (before >= 0) & (before < len(stamps_ns) - 1)
    rows = np.flatnonzero(inside)
    before = before[rows]
    gap = stamps_ns[before + 1] - stamps_ns[before]
    near = gap <= _MAX_GAP_NS
    fraction = (times_ns[rows] - stamps_ns[before]) / np.maximum(gap, 1)
    return before[near], fraction[near], rows[near]


def _with_clock_sigma(
    fit: PositionFit, speed: Floats, source: Floats, sigma_s: float
) -> PositionFit:
    """A fit whose scale includes the uncertainty of the clocks, as far as nothing shows it.

    While the camera accelerates, late positions look like a longer or shorter path.
    """
    sigma_s = min(max(sigma_s, _CLOCK_SIGMA_S), _MAX_CLOCK_SIGMA_S)
    velocity, centred = speed[fit.used], source[fit.used] - source[fit.used].mean(axis=0)
    per_second = float((centred * velocity).sum() / (centred**2).sum())
    return fit._replace(sigma=float(np.hypot(fit.sigma, fit.scale * sigma_s * per_second)))


def _time_offset(
    fit: PositionFit, times_s: Floats, speed: Floats, source: Floats
) -> tuple[float, float]:
    """Seconds by which positions are late, and their standard deviation.

    The residuals of late positions are against the velocity. What rotation, scale and translation
    explain, too, is left out; so a straight path at constant speed shows nothing.
    """
    moved = fit.scale * source[fit.used] @ fit.rotation.T
    centred = moved - moved.mean(axis=0)
    others = np.zeros((3 * len(moved), 7))
    others[:, 0] = centred.ravel()
    for axis, unit in enumerate(np.eye(3)):
        others[:, 1 + axis] = np.cross(unit, centred).ravel()
        others[:, 4 + axis] = np.tile(unit, len(moved))
    against = -(fit.scale * speed[fit.used] @ fit.rotation.T).ravel()
    residuals = fit.residuals[fit.used].ravel()
    both = np.column_stack([against, residuals])
    against_left, left = (both - others @ np.linalg.lstsq(others, both, rcond=1e-9)[0]).T
    information = float(against_left @ against_left)
    if information < _MIN_DISTINCT * float(against @ against):
        return 0.0, np.inf
    late_s = float(against_left @ left) / information
    shape = (-1, 3)
    variance, _ = correlated_variance(
        times_s[fit.used],
        (against_left / information).reshape(shape),
        [column.reshape(shape) for column in (*others.T, against)],
        (left - late_s * against_left).reshape(shape),
    )
    return late_s, float(np.sqrt(variance))
