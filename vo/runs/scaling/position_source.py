"""The scale of a mono path by positions of another sensor, and where the path lies among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from vo.base.errors import SourceError
from vo.base.records.metric_scale import MetricScale, ScaleFindings
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Floats, Ints
from vo.recordings.formats.positions import NS_PER_DAY
from vo.runs.scaling.alternatives import explain
from vo.runs.scaling.clock_search import search_clock
from vo.runs.scaling.fit import PositionFit
from vo.runs.scaling.positions import Positions
from vo.runs.scaling.timed_fit import fit_in_time

MAX_RELATIVE_SIGMA = 0.1
"""A scale that is less certain is refused."""

_MAX_LENGTH_ERROR = 0.01  # of a path in metres, which is not reported
_REPORTED_RATIO = 0.02  # of positions that are refused


@dataclass(frozen=True, eq=False)
class PathAlignment:
    """Where a world lies in the frame of the positions.

    Attributes:
        segment: number of the world.
        rotation: (3, 3).
        translation: (3,) metres.
        positions: at the times of the path's clock.
        offset_s: by which their clock was late.
    """

    segment: int
    rotation: Floats
    translation: Floats
    positions: Positions
    offset_s: float

    def transform(self, xyz: Floats) -> Floats:
        """Positions (N, 3) of the path in metres, among those of the sensor."""
        return np.asarray(xyz @ self.rotation.T + self.translation)


class PositionSource:
    """Compares the path with positions of another sensor.

    Attributes:
        positions: of the other sensor.
        alignments: after `measure`, one of each world that could be compared.

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
        self.lever_arm_m = np.array(lever_arm_m, np.float64)
        self.alignments: tuple[PathAlignment, ...] = ()
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
                f"{time_text(int(times[0]))} to {time_text(int(times[-1]))}, images from "
                f"{time_text(first)} to {time_text(last)}; if the clocks differ, give the "
                "difference by `offset_ns` (starting together: "
                f"{1e-9 * (first - int(times[0])):.3f})"
            )

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """Nothing to do: positions are compared with the final path."""

    def measure(self, path: PosedFrames) -> ScaleFindings:
        """Fit each world of the path to the positions."""
        scales, notes, alignments = [], [], []
        for segment in sorted(set(path.world.tolist())):
            scale, note, alignment = self._measure(path, segment)
            notes += note
            if scale is not None:
                scales.append(scale)
            if alignment is not None:
                alignments.append(alignment)
        self.alignments = tuple(alignments)
        return ScaleFindings(tuple(scales), tuple(notes))

    def _measure(
        self, path: PosedFrames, segment: int
    ) -> tuple[MetricScale | None, list[str], PathAlignment | None]:
        rows = path.world == segment
        stamps_ns, xyz = path.trajectory.stamps_ns[rows], path.trajectory.positions[rows]
        arms = path.trajectory.world_from_cam[rows, :3, :3] @ self.lever_arm_m
        given = self.positions
        if given.is_time_of_day and len(stamps_ns):
            given = given.shifted(_days_ns(given.stamps_ns, stamps_ns))
        fitted = fit_in_time(given, stamps_ns, xyz, arms, is_metric=False)
        shift_ns = search_clock(given, stamps_ns, xyz, None if isinstance(fitted, str) else fitted)
        if shift_ns:
            given = given.shifted(shift_ns)
            fitted = fit_in_time(given, stamps_ns, xyz, arms, is_metric=False)
        where = f"{self.positions.source}, segment {segment}"
        if isinstance(fitted, str):
            return None, [f"{where}: no scale: {fitted}"], None
        found = explain(given, stamps_ns, xyz, arms, fitted)
        if found.fit is None:
            return None, [f"{where}: the positions don't fit the path: {found.cause}"], None
        given, (fit, offset_s) = found.positions, found.fit
        length_notes = self._length_notes(fit) if self._is_metric else []
        if self._is_metric:
            rigid = fit_in_time(given, stamps_ns, xyz, arms, is_metric=True)
            if isinstance(rigid, str):
                return None, [f"{where}: {rigid}"], None
            fit, offset_s = rigid
        notes = _fit_notes(where, fit, offset_s - 1e-9 * shift_ns)
        if found.cause:
            notes.insert(0, f"{where}: {found.cause}, which is corrected")
        moved = given.shifted(-round(1e9 * offset_s))
        late_s = offset_s - 1e-9 * shift_ns
        alignment = PathAlignment(segment, fit.rotation, fit.translation, moved, late_s)
        if self._is_metric:
            return None, notes + length_notes, alignment
        fit = fit._replace(sigma=float(np.hypot(fit.sigma, fit.scale * found.slope_sigma)))
        if fit.sigma > MAX_RELATIVE_SIGMA * fit.scale:
            notes.append(
                f"{where}: the scale cannot be observed: {fit.scale:.4g} ± {fit.sigma:.2g} m per "
                f"map unit, as the path is too short for {_errors(fit)}"
            )
            return None, notes, None
        scale = MetricScale(segment, fit.scale, fit.sigma, self.positions.source)
        return scale, notes, alignment

    def _length_notes(self, fit: PositionFit) -> list[str]:
        """How far the lengths of a path in metres differ from those of the positions."""
        error = 1.0 / fit.scale - 1.0
        if abs(error) <= max(_MAX_LENGTH_ERROR, 3.0 * fit.sigma / fit.scale):
            return []
        return [
            f"lengths differ by {error:+.1%} from those by {self.positions.source}: "
            "check the calibration"
        ]


def _errors(fit: PositionFit) -> str:
    if fit.resolution_m > fit.noise_m:
        return f"positions that are rounded to {fit.resolution_m:.2g} m"
    return f"position errors of {fit.noise_m:.2g} m"


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


def time_text(stamp_ns: int) -> str:
    """A time as text: the date for stamps that can be Unix time."""
    if stamp_ns < 10 * 365 * NS_PER_DAY:
        return f"{1e-9 * stamp_ns:.3f} s"
    moment = datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC)
    return f"{moment:%Y-%m-%d %H:%M:%S} UTC"
