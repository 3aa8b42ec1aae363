"""Wheel odometry as a sensor of a run: the scale of a mono path, and what it says of each world."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from vo.base.errors import SourceError
from vo.base.records.metric_scale import MetricScale, ScaleFindings, WheelUse
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Floats, Ints
from vo.engine.trajectory.metric_segments import MetricSegments
from vo.runs.scaling.path_factors import WayFactors
from vo.runs.scaling.position_source import MAX_RELATIVE_SIGMA, time_text
from vo.runs.scaling.wheel_factors import way_factors, with_noise
from vo.runs.scaling.wheel_fit import WheelFit, fit_wheel, make_steps
from vo.runs.scaling.wheel_odometry import WheelOdometry

RADIUS_SIGMA = 0.015
"""Relative standard deviation of the radius of wheels: load, pressure and wear of tyres."""

_NAME = "wheel odometry"
_MAX_REFUSED = 0.3  # of the steps
_MAX_OFFSET_S = 0.95  # of its clock
_MAX_SPREAD = 0.2  # of the ways of ten parts of the path
_MAX_RADIUS_ERROR = math.log(1.25)
_REPORTED_ERROR, _REPORTED_OFFSET_S = 0.03, 0.1  # of a radius, of a clock


class WheelSource:
    """Compares the path with wheel odometry.

    Attributes:
        name: of the source, in summaries.
        wheel: the samples.
        fits: after `measure`, by number of the world, where wheels and images agree.

    Args:
        wheel: the samples.
        is_metric: whether the path is in metres already, as in stereo.
    """

    def __init__(self, wheel: WheelOdometry, *, is_metric: bool) -> None:
        self.name = _NAME
        self.wheel = wheel
        self.fits: dict[int, WheelFit] = {}
        self._is_metric = is_metric

    def check_times(self, stamps_ns: Ints) -> None:
        """Check before the run that there are samples during the recording.

        Raises:
            SourceError: there are none, because of other clocks or another recording.
        """
        times = self.wheel.stamps_ns
        if len(stamps_ns) and not ((times >= stamps_ns[0]) & (times <= stamps_ns[-1])).any():
            first, last = (time_text(int(stamps_ns[row])) for row in (0, -1))
            raise SourceError(
                f"{self.wheel.name}: no wheel odometry during the recording: samples from "
                f"{time_text(int(times[0]))} to {time_text(int(times[-1]))}, images from {first} "
                f"to {last}; give samples with the clock of the images"
            )

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """Nothing to do: the wheels are compared with the final path."""

    def measure(self, path: PosedFrames) -> ScaleFindings:
        """Fit each world of the path."""
        self.fits, scales, notes = {}, [], []
        for world in sorted(set(path.world.tolist())):
            found = fit_wheel(make_steps(path, world, self.wheel), self.wheel)
            reason = found if isinstance(found, str) else self._contradiction(found)
            if isinstance(found, str) or reason:
                notes.append(f"{_NAME}, segment {world}: left out: {reason}")
                continue
            self.fits[world] = found
            notes += self._notes(world, found)
            sigma = math.hypot(found.sigma, RADIUS_SIGMA * found.scale)
            if not self._is_metric and sigma <= MAX_RELATIVE_SIGMA * found.scale:
                scales.append(MetricScale(world, found.scale, sigma, _NAME))
        return ScaleFindings(tuple(scales), tuple(notes))

    def factors(
        self, world: int, poses: Floats, stamps_ns: Ints, segments: Ints
    ) -> WayFactors | None:
        """Ways between keyframes of a world in metres; None where slip leaves too few."""
        fit = self.fits[world]
        found = way_factors(poses, stamps_ns, segments, self.wheel, fit)
        if found is None:
            return None
        return with_noise(poses, found, fit, RADIUS_SIGMA)

    def uses(self, metric: MetricSegments, moved_m: Mapping[int, float]) -> tuple[WheelUse, ...]:
        """What became of the wheels in each world."""
        found = []
        for world, fit in sorted(self.fits.items()):
            scale = metric.scales.get(world)
            unit_m = 1.0 if scale is None else scale.value
            is_known = metric.is_metric(world) and (scale is None or scale.source != self.name)
            arm = None if fit.is_known or not fit.has_up else fit.arm_m.tolist()
            found.append(
                WheelUse(
                    *(world, fit.used, len(fit.slips_ns), fit.offset_s),
                    fit.scale / unit_m - 1.0 if is_known else None,
                    math.sqrt(fit.noise),
                    arm and (arm[0], arm[1]),
                    moved_m.get(world, 0.0),
                )
            )
        return tuple(found)

    def _contradiction(self, fit: WheelFit) -> str:
        """Why the wheels cannot be believed, empty if they can."""
        if fit.refused_ratio > _MAX_REFUSED:
            return f"it contradicts the images in {fit.refused_ratio:.0%} of the time"
        if abs(fit.offset_s) > _MAX_OFFSET_S:
            return "its clock differs from that of the images by a second or more"
        if fit.spread > _MAX_SPREAD:
            return f"its ways differ from those of the images by {fit.spread:.0%}, and unsteadily"
        if self._is_metric and abs(math.log(fit.scale)) > _MAX_RADIUS_ERROR:
            return f"its ways are {fit.scale:.2f} times those of the images: check the wheel radius"
        return ""

    def _notes(self, world: int, fit: WheelFit) -> list[str]:
        notes, where = [], f"{_NAME}, segment {world}"
        if abs(fit.offset_s) >= _REPORTED_OFFSET_S:
            word = "late" if fit.offset_s > 0 else "early"
            notes.append(f"{where}: it is {abs(fit.offset_s):.2f} s {word}, which is corrected")
        if self._is_metric and abs(math.log(fit.scale)) > _REPORTED_ERROR:
            notes.append(
                f"{where}: its ways are {fit.scale - 1.0:+.1%} longer than those of the images, "
                "which is corrected: check the wheel radius"
            )
        return notes
