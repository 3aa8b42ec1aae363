"""The metric scale of a mono path: what measures it, and what was measured.

The path of one camera is in units of its map. A source of scale, such as GPS, a marker of known
size or the height of the camera, gives the length in metres of one such unit, at the end of a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

from vo.base.frozen import frozen
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate

_MAX_DISAGREEMENT = 3.0  # of two sources, in standard deviations
_MAX_LENGTH_ERROR = 0.01  # of a path in metres, which is not reported


class MetricScale(NamedTuple):
    """Scale of one world of a mono run.

    Attributes:
        segment: number of the world: that of its first segment.
        value: length in metres of one unit of the map.
        sigma: standard deviation of `value`.
        source: what it comes from, such as `gps`, `marker 7`, `imu` or `camera height`.
    """

    segment: int
    value: float
    sigma: float
    source: str

    @property
    def relative_sigma(self) -> float:
        """Standard deviation relative to the value: that of every length."""
        return self.sigma / self.value


class WorldFrame(NamedTuple):
    """A frame of markers that a world of a run was given.

    Attributes:
        segment: number of the world: that of its first segment.
        name: of the frame: `marker 7`, or the file of a map.
        markers: ids by which the world was placed.
        sigma_m: standard deviation of the position, where the markers are.
        sigma_deg: standard deviation of the rotation.
    """

    segment: int
    name: str
    markers: tuple[int, ...]
    sigma_m: float
    sigma_deg: float


class PositionUse(NamedTuple):
    """What became of the positions of another sensor in one world of a run.

    Attributes:
        segment: number of the world: that of its first segment.
        source: what they come from, such as `gps`.
        used: positions that were used.
        refused: outliers among the others.
        jumps: number of jumps, between which each part was placed by itself.
        offset_s: by which their clock is late, which was corrected.
        white_m: standard deviation, along one axis, of errors that are independent.
        slow_m: of errors that are correlated in time.
        slow_s: after which their correlation is 1/e.
        moved_m: root mean square distance by which keyframes were moved; 0 for a path that
            explains the positions as it is.
        sigma_m: standard deviation of the position of a keyframe in the frame of the positions,
            and of its rotation; None where nothing was moved.
        sigma_deg: as above.
    """

    segment: int
    source: str
    used: int
    refused: int
    jumps: int
    offset_s: float
    white_m: float
    slow_m: float
    slow_s: float
    moved_m: float
    sigma_m: float | None = None
    sigma_deg: float | None = None


class WheelUse(NamedTuple):
    """What became of wheel odometry in one world of a run.

    Attributes:
        segment: number of the world: that of its first segment.
        used: steps that were compared.
        refused: among the others, those in which wheels slipped.
        offset_s: by which their clock is late, which was corrected.
        length_error: of the ways of the wheels relative to those of the path in metres, which the
            radius explains; None where nothing else knows metres.
        noise: standard deviation of the way of one metre.
        arm_m: where the camera is, ahead of the wheels' centre and to the left of it; None if that
            was given, or does not show.
        moved_m: root mean square distance by which keyframes were moved with ways as factors.
    """

    segment: int
    used: int
    refused: int
    offset_s: float
    length_error: float | None
    noise: float
    arm_m: tuple[float, float] | None
    moved_m: float = 0.0


@frozen()
class ScaleFindings:
    """What sources of scale have measured.

    Attributes:
        scales: at most one of each world.
        notes: sentences for the user: why there is no scale, and what was left out.
        world_frames: at most one of each world whose frame is not that of its first camera.
        positions: at most one of each world that positions could move.
        wheel: at most one of each world that wheel odometry agrees with.
    """

    scales: tuple[MetricScale, ...] = ()
    notes: tuple[str, ...] = ()
    world_frames: tuple[WorldFrame, ...] = ()
    positions: tuple[PositionUse, ...] = ()
    wheel: tuple[WheelUse, ...] = ()

    def by_segment(self) -> dict[int, MetricScale]:
        """The scales by the number of their world."""
        return {scale.segment: scale for scale in self.scales}


class ScaleSource(Protocol):
    """Measures the scale of a mono run, without changing how it is tracked."""

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """After each frame; `snapshot` takes time and can only be called before this returns."""

    def measure(self, path: PosedFrames) -> ScaleFindings:
        """After the last frame: scales of the worlds of the final path, in units of the map."""


def choose_scales(findings: Sequence[ScaleFindings]) -> ScaleFindings:
    """The scale with the smallest relative sigma of each world, and all notes.

    A source that contradicts it by more than three standard deviations is reported.
    """
    notes = [note for each in findings for note in each.notes]
    by_segment: dict[int, list[MetricScale]] = {}
    for each in findings:
        for scale in each.scales:
            by_segment.setdefault(scale.segment, []).append(scale)
    chosen = []
    for segment in sorted(by_segment):
        best, *others = sorted(by_segment[segment], key=lambda scale: scale.relative_sigma)
        chosen.append(best)
        notes += [_contradiction(best, other) for other in others if _contradict(best, other)]
    return ScaleFindings(tuple(chosen), tuple(notes))


def without_metric(
    findings: ScaleFindings, by_map: Collection[int], by_sensor: Collection[int] = ()
) -> ScaleFindings:
    """Findings without the scales of worlds in metres by a loaded map or an inertial sensor.

    A difference of more than 1 % and three standard deviations is reported.
    """
    metric = {*by_map, *by_sensor}
    kept = tuple(scale for scale in findings.scales if scale.segment not in metric)
    notes = list(findings.notes)
    for scale in findings.scales:
        limit = max(_MAX_LENGTH_ERROR, _MAX_DISAGREEMENT * scale.relative_sigma)
        if scale.segment in metric and abs(math.log(scale.value)) > limit:
            other = "loaded map" if scale.segment in by_map else "inertial sensor"
            notes.append(
                f"in segment {scale.segment} all lengths would be {scale.value - 1.0:+.1%} longer "
                f"by {scale.source} than by the {other}, whose metres are kept"
            )
    return replace(findings, scales=kept, notes=tuple(notes))


def has_all_scales(segments: Sequence[int], scales: Collection[int]) -> bool:
    """Whether every world of a path, of which there is at least one, has a scale."""
    return bool(segments) and all(segment in scales for segment in segments)


def _contradict(first: MetricScale, second: MetricScale) -> bool:
    difference = abs(math.log(first.value / second.value))
    sigma = math.hypot(first.relative_sigma, second.relative_sigma)
    return difference > _MAX_DISAGREEMENT * sigma


def _contradiction(best: MetricScale, other: MetricScale) -> str:
    return (
        f"the scale by {other.source} differs by {other.value / best.value - 1.0:+.1%} from that "
        f"by {best.source}, which is used: more than their uncertainty allows"
    )
