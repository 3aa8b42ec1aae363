"""Summary of a run, as written to `summary.json`; docs/outputs.md explains every key."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any, Literal, NamedTuple

import numpy as np

from vo.base.failures import Failure
from vo.base.frozen import frozen
from vo.base.geometry.rig_overlap import is_rig
from vo.base.records.calibration_errors import (
    CalibrationErrors,
    CameraPoseError,
    LensError,
    RightCameraError,
)
from vo.base.records.closed_loops import ClosedLoop, MapUse, Relocalisation, are_doubtful
from vo.base.records.estimated_camera import EstimatedCamera
from vo.base.records.focal_length import FocalLength
from vo.base.records.inertial_use import InertialStates, InertialUse
from vo.base.records.metric_scale import (
    MetricScale,
    PositionUse,
    ScaleFindings,
    WheelUse,
    WorldFrame,
    has_all_scales,
)
from vo.base.records.posed_frames import PosedFrames
from vo.base.types import Ints, Rig, Skipped, State
from vo.outputs.results.environment import peak_rss_mb, versions
from vo.outputs.results.live_summary import LiveState, delay_of
from vo.outputs.results.run_statistics import (
    FaultRecord,
    FrameRange,
    Profile,
    RunStatistics,
    StageTime,
    ranges_without_pose,
)
from vo.outputs.results.verdict import Verdict, VerdictFacts, assess
from vo.outputs.results.warnings import run_warnings
from vo.recordings.formats.warning_kinds import LoggedWarning

Status = Literal["finished", "interrupted", "failed"]

SCHEMA_VERSION = 1

_DIGITS: Mapping[object, int | str] = {  # decimals of the numbers of a record, or their format
    StageTime: 3,
    FaultRecord: 4,
    RightCameraError: 3,
    LensError: 5,
    ClosedLoop: 4,
    Relocalisation: 4,
    MetricScale: ".9g",
    (WorldFrame, "sigma_m"): ".4g",
    (WorldFrame, "sigma_deg"): 4,
    PositionUse: 4,
    WheelUse: 4,
    InertialUse: 6,
    InertialStates: ".6g",
}
# Keys that are missing where there is nothing to tell.
_OPTIONAL = (
    *("map", "scale", "world_frames", "positions", "wheel", "inertial", "profile", "live"),
    *("earlier_session", "marker", "camera_errors"),
)
# Fields that are no keys: reasons, warnings and faults tell them.
LEFT_OUT = (
    *("opening_warnings", "notes", "main_failure", "defect", "is_contradiction"),
    "has_free_scale",
)


RunMode = Literal["mono", "stereo", "rgbd", "rig"]


def mode_of(rig: Rig) -> RunMode:
    """Which kind of cameras a run has."""
    if is_rig(rig):
        return "rig"
    return "rgbd" if rig.has_depth else "stereo" if rig.is_stereo else "mono"


@frozen()
class RunFacts:
    """Properties of a run that are known before its first frame.

    Of the `requested` frames every `every`-th is tracked. `calibration`, `topics` and
    `right_offset_ns` are those given by the user.
    """

    source: str
    format: str
    mode: RunMode
    has_ground_truth: bool
    seed: int
    start: int
    end: int
    stride: int
    requested: int
    every: int = 1
    calibration: str | None = None
    topics: tuple[str, ...] = ()
    right_offset_ns: int | None = None
    opening_warnings: tuple[LoggedWarning, ...] = ()
    estimated_camera: EstimatedCamera | None = None
    focal_lengths: tuple[FocalLength, ...] = ()  # that were followed


class Segment(NamedTuple):
    """A part of the path with its own world frame; lengths in the summary's unit.

    Segments that were connected later are one, with the number of the first.
    """

    segment: int
    first_frame: int
    last_frame: int
    first_stamp_ns: int
    last_stamp_ns: int
    frames: int
    path_m: float


@frozen(kw_only=True)
class Summary:
    """Summary of a run, with the fields of `summary.json` in their order."""

    status: Status
    error: str | None = None
    frames: int
    tracked: int
    interpolated: int
    inertial_poses: int
    inertial_orientations: int
    untracked: int
    starting: int
    lost: int
    skipped: tuple[Skipped, ...]
    unpaired: int = 0
    without_pose: tuple[FrameRange, ...]
    segments: tuple[Segment, ...]
    keyframes: int
    landmarks: int
    path_m: float
    wall_s: float
    peak_rss_mb: float
    versions: Mapping[str, str]
    median_inliers: float | None
    median_disparity_px: float | None
    disparity_offset_px: float
    disparity_curve_px: float = 0.0
    faults: tuple[FaultRecord, ...] = ()
    hidden: tuple[float, ...] = ()
    loops: tuple[ClosedLoop, ...] = ()
    relocalisations: tuple[Relocalisation, ...] = ()
    networks: tuple[Mapping[str, str], ...] = ()
    facts: RunFacts
    right_camera: RightCameraError | None = None
    lens_error: LensError | None = None
    camera_errors: tuple[CameraPoseError, ...] = ()
    map: MapUse | None = None
    scale: ScaleFindings | None = None
    inertial: InertialUse | None = None
    stages: Mapping[str, StageTime]
    profile: Profile | None = None
    live: LiveState | None = None
    main_failure: Failure | None = None
    has_free_scale: bool = False  # of cameras that have too little in common

    @property
    def is_metric(self) -> bool:
        """Whether every length is in metres: in mono, whether all segments have a scale."""
        if self.facts.mode != "mono" and not self.has_free_scale:
            return True
        scales = {} if self.scale is None else self.scale.by_segment()
        upright = () if self.inertial is None else self.inertial.metric_worlds
        known = () if self.map is None else self.map.metric_worlds
        worlds = [each.segment for each in self.segments]
        return has_all_scales(worlds, {*scales, *upright, *known})

    @property
    def length_unit(self) -> str:
        """Unit of every length: metres, or the arbitrary units of a mono map."""
        return "m" if self.is_metric else "map units"

    @property
    def frames_per_s(self) -> float:
        """Processed frames per second of wall time."""
        return self.frames / self.wall_s if self.wall_s > 0 else 0.0

    @property
    def verdict(self) -> Verdict:
        """How complete the path is, and whether it can be trusted."""
        return assess(
            VerdictFacts(
                self.status,
                self.frames,
                self.tracked + self.interpolated,
                len(self.segments),
                self.median_inliers,
                are_doubtful(self.loops)
                or not all(record.is_handled for record in self.faults)
                or any(each.is_doubt for each in self.facts.opening_warnings),
                self.disparity_offset_px,
                bool(self.warnings),
            )
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Conditions that make the result less accurate or incomplete."""
        return tuple(run_warnings(self))

    @property
    def closing_warnings(self) -> tuple[str, ...]:
        """Those to show at the end: warnings of opening only if they make the path doubtful."""
        opening = self.facts.opening_warnings
        shown = {each.text for each in opening if not each.is_doubt}
        return tuple(text for text in self.warnings if text not in shown)

    def to_dict(self) -> dict[str, Any]:
        """Content of `summary.json`."""
        return {
            "schema_version": SCHEMA_VERSION,
            **_plain(self),
            "length_unit": self.length_unit,
            "frames_per_s": round(self.frames_per_s, 3),
            "warnings": list(self.warnings),
            "verdict": self.verdict.word,
            "trusted": self.verdict.is_trusted,
        }


def summarise(
    facts: RunFacts,
    status: Status,
    statistics: RunStatistics,
    path: PosedFrames,
    calibration: CalibrationErrors,
    *,
    live: LiveState | None = None,
    **found: Any,
) -> Summary:
    """Summary of a run that has finished or is still going on.

    `facts`: what was known before the first frame. `status`: how the run ended, or would have ended
    if it stopped now. `statistics`: over the processed frames. `path`: the frames that have a pose.
    `calibration`: errors of the calibration that were found. `live`: None for a recording.
    `**found`: the other fields of the summary, by their names.
    """
    skipped = tuple(found.pop("skipped", ()))
    ranges, count = ranges_without_pose(
        statistics, path.frame_index, skipped, _untracked(facts, status, statistics)
    )
    posed, segments = _posed(path), _segments(path)
    # The disparities of a depth camera are relative to a virtual right camera.
    disparity_px = statistics.median_disparity_px if facts.mode == "stereo" else None
    # Orientations alone are stored relative to an origin, which is no keyframe.
    keyframes = found.pop("keyframes")
    return Summary(
        status=status,
        facts=facts,
        frames=len(path.frame_index) + sum(count.values()),
        **posed,
        untracked=count["untracked"],
        starting=count[State.STARTING.value],
        lost=count[State.LOST.value],
        skipped=skipped,
        without_pose=tuple(ranges),
        segments=tuple(segments),
        keyframes=keyframes if posed["tracked"] else 0,
        landmarks=statistics.landmarks,
        path_m=round(sum(s.path_m for s in segments), 6),
        wall_s=round(found.pop("wall_s"), 3),
        stages=statistics.stages(),
        peak_rss_mb=round(peak_rss_mb(), 1),
        versions=versions(),
        median_inliers=statistics.median_inliers,
        median_disparity_px=None if disparity_px is None else round(disparity_px, 2),
        disparity_offset_px=round(calibration.disparity_offset_px, 4),
        disparity_curve_px=round(calibration.disparity_curve_px, 4),
        right_camera=calibration.right_camera,
        lens_error=calibration.lens_error,
        camera_errors=calibration.cameras,
        main_failure=statistics.main_failure(),
        faults=statistics.faults.records(),
        hidden=tuple(round(ratio, 4) for ratio in found.pop("hidden", ())),
        live=None if live is None else live._replace(delay_ms=delay_of(statistics.delays_ms)),
        **found,
    )


def _posed(path: PosedFrames) -> dict[str, Any]:
    """Numbers of frames with a pose, by where it comes from."""
    interpolated = int(path.interpolated.sum())
    inertial = 0 if path.inertial is None else int(np.count_nonzero(path.inertial))
    turned = 0 if path.inertial is None else int(np.count_nonzero(path.inertial == -2))
    return {
        "tracked": len(path.frame_index) - interpolated - inertial,
        "interpolated": interpolated,
        "inertial_poses": inertial - turned,
        "inertial_orientations": turned,
    }


def _untracked(facts: RunFacts, status: Status, statistics: RunStatistics) -> Ints:
    """Numbers of the frames so far that `tracking.every` left out."""
    if facts.every == 1 or not statistics.frames:
        return np.empty(0, np.int64)
    stop = facts.end if status == "finished" else statistics.frames[-1] + 1
    requested = np.arange(facts.start, stop, facts.stride)
    return np.asarray(requested[np.arange(len(requested)) % facts.every != 0])


def _segments(path: PosedFrames) -> list[Segment]:
    steps = np.linalg.norm(np.diff(path.trajectory.positions, axis=0), axis=1)
    steps[np.diff(path.segment) != 0] = 0.0  # the way between segments is unknown
    segments = []
    for number in sorted(set(path.world.tolist())):
        rows = np.flatnonzero(path.world == number)
        first, last = int(rows[0]), int(rows[-1])
        segments.append(
            Segment(
                number,
                int(path.frame_index[first]),
                int(path.frame_index[last]),
                int(path.trajectory.stamps_ns[first]),
                int(path.trajectory.stamps_ns[last]),
                len(rows),
                round(float(steps[rows[:-1]].sum()), 6),
            )
        )
    return segments


def _plain(value: Any, digits: int | str | None = None) -> Any:
    """A value of a summary for JSON, with decimals, or a format, of its numbers."""
    names = getattr(value, "_fields", ()) or getattr(value, "__dataclass_fields__", ())
    if names:
        return _record(value, names)
    if isinstance(value, Mapping):
        return {name: _plain(each, digits) for name, each in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(each, digits) for each in value]
    if isinstance(value, Enum):
        return value.value
    if digits is None or not isinstance(value, float):
        return value
    return round(value, digits) if isinstance(digits, int) else float(format(value, digits))


def _record(record: Any, names: Iterable[str]) -> dict[str, Any]:
    kind, fields = type(record), {}
    for name in names:
        value = getattr(record, name)
        plain = _plain(value, _DIGITS.get((kind, name), _DIGITS.get(kind)))
        if isinstance(value, RunFacts | ScaleFindings):
            fields.update(plain)  # their fields are keys of the summary
        elif name not in LEFT_OUT and not (name in _OPTIONAL and plain in (None, [])):
            fields[name] = plain
    return fields
