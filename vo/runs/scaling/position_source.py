"""The scale of a mono path by positions of another sensor, and where the path lies among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from vo.base.errors import SourceError
from vo.base.records.metric_scale import MetricScale, ScaleFindings
from vo.base.records.placed_frames import PlacedFrames
from vo.base.types import Estimate, Floats, Ints, Snapshot
from vo.recordings.formats.positions import NS_PER_DAY
from vo.runs.scaling.correlation import correlated_variance
from vo.runs.scaling.fit import MIN_POSITIONS, PositionFit, fit_positions
from vo.runs.scaling.positions import Positions

MAX_RELATIVE_SIGMA = 0.1
"""A scale that is less certain is refused."""

_MAX_GAP_NS = 1_000_000_000  # between poses of the path, over which positions are interpolated
_MIN_OFFSET_S = 0.1  # of clocks, which is corrected and reported
_ACCURATE_OFFSET_S = 0.01  # where the correction ends
_OFFSET_SIGMAS = 4.0
_CLOCK_SIGMA_S = 0.05  # of an offset that is not corrected
_MIN_DISTINCT = 1e-4  # fraction of the squared speed that nothing else explains
_MAX_LENGTH_ERROR = 0.01  # of a path in metres, which is not reported
_ARM_ROUNDS = 8
_REPORTED_RATIO = 0.02  # of positions that are refused


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a world lies in the frame of the positions.

    Attributes:
        segment: number of the world.
        rotation: (3, 3).
        translation: (3,) metres.
    """

    segment: int
    rotation: Floats
    translation: Floats

    def place(self, xyz: Floats) -> Floats:
        """Positions (N, 3) of the path in metres, among those of the sensor."""
        return np.asarray(xyz @ self.rotation.T + self.translation)


class PositionSource:
    """Compares the path with positions of another sensor.

    Attributes:
        positions: of the other sensor.
        placements: after `measure`, one of each world that could be compared.

    Args:
        positions: of the other sensor.
        is_metric: whether the path is in metres already, as in stereo.
        lever_arm_m: (3,) where the other sensor is in the frame of the left camera.
    """

    def __init__(
        self,
        positions: Positions,
        *,
        is_metric: bool = False,
        lever_arm_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.positions = positions
        self._lever_arm_m = np.array(lever_arm_m, np.float64)
        self.placements: tuple[Placement, ...] = ()
        self._is_metric = is_metric

    def check_times(self, stamps_ns: Ints) -> None:
        """Check before the run that there are positions during the recording.

        Raises:
            SourceError: there are none, because of other clocks or another recording.
        """
        if not len(stamps_ns) or self.positions.is_time_of_day:
            return
        times = self.positions.stamps_ns
        inside = (times >= stamps_ns[0]) & (times <= stamps_ns[-1])
        if not inside.any():
            first, last = int(stamps_ns[0]), int(stamps_ns[-1])
            raise SourceError(
                f"{self.positions.name}: no position during the recording: positions from "
                f"{_time(int(times[0]))} to {_time(int(times[-1]))}, images from {_time(first)} to "
                f"{_time(last)}; if the clocks differ, give the difference by `offset_ns` "
                f"(starting together: {1e-9 * (first - int(times[0])):.3f})"
            )

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """Nothing to do: positions are compared with the final path."""

    def measure(self, path: PlacedFrames) -> ScaleFindings:
        """Fit each world of the path to the positions."""
        scales, notes, placements = [], [], []
        for segment in sorted(set(path.world.tolist())):
            scale, note, placement = self._measure(path, segment)
            notes += note
            if scale is not None:
                scales.append(scale)
            if placement is not None:
                placements.append(placement)
        self.placements = tuple(placements)
        return ScaleFindings(tuple(scales), tuple(notes))

    def _measure(
        self, path: PlacedFrames, segment: int
    ) -> tuple[MetricScale | None, list[str], Placement | None]:
        rows = path.world == segment
        stamps_ns, xyz = path.trajectory.stamps_ns[rows], path.trajectory.positions[rows]
        arms = path.trajectory.world_from_cam[rows, :3, :3] @ self._lever_arm_m
        given = self.positions
        if given.is_time_of_day and len(stamps_ns):
            given = given.shifted(_days_ns(given.stamps_ns, stamps_ns))
        fitted = _fit(given, stamps_ns, xyz, arms, is_metric=self._is_metric)
        where = f"{self.positions.source}, segment {segment}"
        if isinstance(fitted, str):
            return None, [f"{where}: no scale: {fitted}"], None
        fit, offset_s = fitted
        notes = _fit_notes(where, fit, offset_s)
        placement = Placement(segment, fit.rotation, fit.translation)
        if self._is_metric:
            return None, notes + self._length_notes(given, stamps_ns, xyz, arms), placement
        if fit.sigma > MAX_RELATIVE_SIGMA * fit.scale:
            notes.append(
                f"{where}: the scale cannot be observed: {fit.scale:.4g} ± {fit.sigma:.2g} m per "
                f"map unit, as the path is too short for position errors of {fit.noise_m:.2g} m"
            )
            return None, notes, None
        scale = MetricScale(segment, fit.scale, fit.sigma, self.positions.source)
        return scale, notes, placement

    def _length_notes(
        self, given: Positions, stamps_ns: Ints, xyz: Floats, arms: Floats
    ) -> list[str]:
        """How far the lengths of a path in metres differ from those of the positions."""
        fitted = _fit(given, stamps_ns, xyz, arms, is_metric=False)
        if isinstance(fitted, str):
            return []
        fit, _ = fitted
        error = 1.0 / fit.scale - 1.0
        if abs(error) <= max(_MAX_LENGTH_ERROR, 3.0 * fit.sigma / fit.scale):
            return []
        return [
            f"lengths differ by {error:+.1%} from those by {given.source}: check the calibration"
        ]


def _fit(
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
    offset_ns = 0
    result: PositionFit | None = None
    for _ in range(5):
        moved = given.shifted(offset_ns)
        between, fraction, rows = _associate(stamps_ns, moved.stamps_ns)
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
        fit = fit_positions(times_s, source, xyz_m, known, with_scale=not is_metric)
        if fit is not None and arm.any() and not is_metric:
            camera = source
            for _ in range(_ARM_ROUNDS):  # the scale gives the arm its length in map units
                source = camera + arm / fit.scale
                fit = fit_positions(times_s, source, xyz_m, known) or fit
        if fit is None:
            return "the path or the positions do not move"
        elapsed = (stamps_ns[between + 1] - stamps_ns[between])[:, None] * 1e-9
        speed = (xyz[between + 1] - xyz[between]) / elapsed
        late_s = _time_offset(fit, times_s, speed, source, 0.0 if offset_ns else _OFFSET_SIGMAS)
        result = _with_clock_sigma(fit, speed, source)
        if abs(late_s) < (_ACCURATE_OFFSET_S if offset_ns else _MIN_OFFSET_S):
            break
        offset_ns -= round(1e9 * late_s)
    assert result is not None
    return result, -1e-9 * offset_ns


def _associate(stamps_ns: Ints, times_ns: Ints) -> tuple[Ints, Floats, Ints]:
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


def _with_clock_sigma(fit: PositionFit, speed: Floats, source: Floats) -> PositionFit:
    """A fit whose scale includes the uncertainty of the clocks.

    While the camera accelerates, late positions look like a longer or shorter path.
    """
    velocity, centred = speed[fit.used], source[fit.used] - source[fit.used].mean(axis=0)
    per_second = float((centred * velocity).sum() / (centred**2).sum())
    return fit._replace(sigma=float(np.hypot(fit.sigma, fit.scale * _CLOCK_SIGMA_S * per_second)))


def _time_offset(
    fit: PositionFit, times_s: Floats, speed: Floats, source: Floats, min_sigmas: float
) -> float:
    """Seconds by which positions are late, 0 unless that is certain by so many deviations.

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
        return 0.0
    late_s = float(against_left @ left) / information
    shape = (-1, 3)
    variance, _ = correlated_variance(
        times_s[fit.used],
        (against_left / information).reshape(shape),
        [column.reshape(shape) for column in (*others.T, against)],
        (left - late_s * against_left).reshape(shape),
    )
    return late_s if abs(late_s) > min_sigmas * np.sqrt(variance) else 0.0


def _fit_notes(where: str, fit: PositionFit, offset_s: float) -> list[str]:
    notes = []
    refused, count = int((~fit.used).sum()), len(fit.used)
    if refused > _REPORTED_RATIO * count:
        notes.append(f"{where}: {refused} of {count} positions refused as outliers")
    if fit.jumps:
        times = "once" if fit.jumps == 1 else f"{fit.jumps} times"
        notes.append(f"{where}: the positions jump {times}; each part is placed by itself")
    if offset_s:
        word = "late" if offset_s > 0 else "early"
        notes.append(
            f"{where}: the positions are {abs(offset_s):.2f} s {word}, which is corrected; "
            "`offset_ns` gives the difference of the clocks"
        )
    return notes


def _days_ns(times_ns: Ints, stamps_ns: Ints) -> int:
    """Whole days that bring times of day closest to the path."""
    difference = int(np.median(stamps_ns)) - int(np.median(times_ns))
    return round(difference / NS_PER_DAY) * NS_PER_DAY


def _time(stamp_ns: int) -> str:
    """A time as text: the date for stamps that can be Unix time."""
    if stamp_ns < 10 * 365 * NS_PER_DAY:
        return f"{1e-9 * stamp_ns:.3f} s"
    moment = datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC)
    return f"{moment:%Y-%m-%d %H:%M:%S} UTC"
