"""What a run says of itself in `summary.json`; every key is explained in docs/outputs.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from vo.calibration_errors import CalibrationErrors, LensError, RightCameraError
from vo.failures import ImageDefect
from vo.results.account import Account, StageTime
from vo.results.environment import peak_rss_mb, versions
from vo.results.profile import Profile
from vo.results.unplaced import FrameRange, unplaced_ranges
from vo.types import Floats, Ints, PlacedFrames, Skipped, State

Status = Literal["finished", "interrupted", "failed"]

SCHEMA_VERSION = 1

_WORTH_TELLING_PX = 0.05
_BEYOND_TRUST_PX = 3.0  # more is no slightly wrong rectification
_BEYOND_LENS_PX = 15.0  # at the image's edges; more is no slightly wrong lens
_USUAL_OFFSET_PX = 0.1  # of the disparities of a well calibrated pair
_FAR_PX = 2.0  # median disparity below which that makes lengths 5 % wrong
_FEW_INLIERS = 50
_LONG_START = 0.1  # of all frames
_MOST_RANGES = 3  # in a warning


@dataclass(frozen=True)
class RunFacts:
    """What is known of a run before its first frame.

    Of the `requested` frames that were asked for, each `every`-th is tracked. `calibration` and
    `topics` are as given, if they were.
    """

    source: str
    format: str
    mode: Literal["mono", "stereo", "rgbd"]
    has_ground_truth: bool
    seed: int
    start: int
    end: int
    stride: int
    requested: int
    every: int = 1
    calibration: str | None = None
    topics: tuple[str, ...] = ()


class Segment(NamedTuple):
    """A stretch of the path in one world; lengths in the summary's unit."""

    segment: int
    first_frame: int
    last_frame: int
    first_stamp_ns: int
    last_stamp_ns: int
    frames: int
    path_m: float


@dataclass(frozen=True)
class Summary:
    """A run in numbers; `to_dict` is what stands in `summary.json`."""

    status: Status
    error: str | None
    facts: RunFacts
    frames: int
    tracked: int
    interpolated: int
    untracked: int
    starting: int
    lost: int
    skipped: tuple[Skipped, ...]
    unpaired: int
    without_pose: tuple[FrameRange, ...]
    segments: tuple[Segment, ...]
    keyframes: int
    landmarks: int
    path_m: float
    wall_s: float
    stages: Mapping[str, StageTime]
    peak_rss_mb: float
    versions: Mapping[str, str]
    median_inliers: float | None
    median_disparity_px: float | None
    disparity_offset_px: float
    disparity_curve_px: float = 0.0
    right_camera: RightCameraError | None = None
    lens_error: LensError | None = None
    profile: Profile | None = None

    @property
    def length_unit(self) -> str:
        """Of every length: metres, or what the mono map happens to be measured in."""
        return "map units" if self.facts.mode == "mono" else "m"

    @property
    def frames_per_s(self) -> float:
        """Frames taken in per second of wall time."""
        return self.frames / self.wall_s if self.wall_s > 0 else 0.0

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know before trusting the result."""
        return tuple(_warnings(self))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}
        facts, stages = fields.pop("facts"), fields.pop("stages")
        profile, right, lens = (fields.pop(n) for n in ("profile", "right_camera", "lens_error"))
        return {
            "schema_version": SCHEMA_VERSION,
            **fields,
            **asdict(facts),
            "right_camera": None if right is None else _rounded(right),
            "lens_error": None if lens is None else _rounded(lens, 5),
            "topics": list(facts.topics),
            "skipped": [asdict(s) for s in self.skipped],
            "without_pose": [_range_fields(r) for r in self.without_pose],
            "segments": [s._asdict() for s in self.segments],
            "stages": {name: _rounded(times) for name, times in stages.items()},
            **({} if profile is None else {"profile": profile._asdict()}),
            "versions": dict(self.versions),
            "length_unit": self.length_unit,
            "frames_per_s": round(self.frames_per_s, 3),
            "warnings": list(self.warnings),
        }


def summarise(
    facts: RunFacts,
    status: Status,
    account: Account,
    placed: PlacedFrames,
    *,
    keyframes: int,
    skipped: Sequence[Skipped],
    unpaired: int,
    wall_s: float,
    calibration: CalibrationErrors,
    error: str | None = None,
    profile: Profile | None = None,
) -> Summary:
    """Put a run into numbers, as far as it has come."""
    untracked = _untracked(facts, status, account)
    ranges, count = unplaced_ranges(account, placed.frame_index, skipped, untracked)
    interpolated = int(placed.interpolated.sum())
    segments = _segments(placed)
    # A depth camera's disparities are to a right camera that is not there.
    disparity_px = account.median_disparity_px if facts.mode == "stereo" else None
    return Summary(
        status=status,
        error=error,
        facts=facts,
        frames=len(placed.frame_index) + sum(count.values()),
        tracked=len(placed.frame_index) - interpolated,
        interpolated=interpolated,
        untracked=count["untracked"],
        starting=count[State.STARTING.value],
        lost=count[State.LOST.value],
        skipped=tuple(skipped),
        unpaired=unpaired,
        without_pose=tuple(ranges),
        segments=tuple(segments),
        keyframes=keyframes,
        landmarks=account.landmarks,
        path_m=round(sum(s.path_m for s in segments), 6),
        wall_s=round(wall_s, 3),
        stages=account.stages(),
        peak_rss_mb=round(peak_rss_mb(), 1),
        versions=versions(),
        median_inliers=account.median_inliers,
        median_disparity_px=None if disparity_px is None else round(disparity_px, 2),
        disparity_offset_px=round(calibration.disparity_offset_px, 4),
        disparity_curve_px=round(calibration.disparity_curve_px, 4),
        right_camera=calibration.right_camera,
        lens_error=calibration.lens_error,
        profile=profile,
    )


def _untracked(facts: RunFacts, status: Status, account: Account) -> Ints:
    """Numbers of the frames that were reached but, by `tracking.every`, not looked at."""
    if facts.every == 1 or not account.frames:
        return np.empty(0, np.int64)
    stop = facts.end if status == "finished" else account.frames[-1] + 1
    asked = np.arange(facts.start, stop, facts.stride)
    return np.asarray(asked[np.arange(len(asked)) % facts.every != 0])


def _range_fields(range_: FrameRange) -> dict[str, Any]:
    fields = range_._asdict()
    del fields["defect"]  # the reason tells it
    return fields


def _segments(placed: PlacedFrames) -> list[Segment]:
    steps = np.linalg.norm(np.diff(placed.trajectory.positions, axis=0), axis=1)
    segments = []
    for number in sorted(set(placed.segment.tolist())):
        rows = np.flatnonzero(placed.segment == number)
        first, last = int(rows[0]), int(rows[-1])
        segments.append(
            Segment(
                number,
                int(placed.frame_index[first]),
                int(placed.frame_index[last]),
                int(placed.trajectory.stamps_ns[first]),
                int(placed.trajectory.stamps_ns[last]),
                len(rows),
                round(_path_length(steps[first:last]), 6),
            )
        )
    return segments


def _path_length(steps: Floats) -> float:
    """Sum of the steps within a segment: between two segments there is none."""
    return float(steps.sum())


def _rounded(values: StageTime | RightCameraError | LensError, digits: int = 3) -> dict[str, float]:
    return {name: round(value, digits) for name, value in values._asdict().items()}


def _warnings(summary: Summary) -> list[str]:
    frames, lost = summary.frames, summary.lost
    warnings = []
    if summary.tracked == 0:
        reasons = [r.reason for r in summary.without_pose if r.state != "skipped"]
        warnings.append(f"no frame was tracked ({reasons[-1] if reasons else 'no frame read'})")
    elif summary.starting > _LONG_START * frames:
        warnings.append(f"{summary.starting} of {frames} frames while there was no map")
    for light in ImageDefect:
        warnings += _of_light(summary.without_pose, light)
    if lost:
        warnings.append(f"lost in {lost} of {frames} frames ({lost / frames:.0%})")
    if summary.skipped:
        warnings.append(f"{len(summary.skipped)} frames skipped: their images cannot be used")
    if summary.unpaired:
        warnings.append(f"{summary.unpaired} frames used without their right or depth image")
    if summary.tracked and (summary.median_inliers or 0.0) < _FEW_INLIERS:
        warnings.append(f"poor tracking: median of {summary.median_inliers or 0:.0f} inliers")
    if summary.right_camera is not None:
        warnings.append(_of_right_camera(summary.right_camera))
    explained = summary.right_camera is not None and summary.right_camera.yaw_deg != 0.0
    if abs(summary.disparity_offset_px) >= _WORTH_TELLING_PX and not explained:
        warnings.append(_of_offset(summary.disparity_offset_px))
    if abs(summary.disparity_curve_px) >= _WORTH_TELLING_PX and not explained:
        warnings.append(_of_curve(summary.disparity_curve_px))
    if summary.lens_error is not None:
        warnings.append(_of_lens(summary.lens_error))
    if summary.median_disparity_px is not None and summary.median_disparity_px < _FAR_PX:
        warnings.append(_of_far_scene(summary.median_disparity_px))
    if len(summary.segments) > 1:
        warnings.append(f"{len(summary.segments)} segments, each in a world of its own")
    if summary.facts.mode == "mono" and summary.tracked:
        warnings.append(
            "mono: the scale is unknown, lengths are in map units (vo eval --align sim3)"
        )
    return warnings


def _of_far_scene(disparity_px: float) -> str:
    share = _USUAL_OFFSET_PX / disparity_px
    return (
        f"all is far away for this baseline (median disparity {disparity_px:.1f} px): a stereo "
        f"calibration that is off by {_USUAL_OFFSET_PX} px makes lengths {share:.0%} wrong"
    )


def _of_light(without_pose: Sequence[FrameRange], light: ImageDefect) -> list[str]:
    ranges = [r for r in without_pose if r.defect is light]
    if not ranges:
        return []
    said = [str(r.first) if r.frames == 1 else f"{r.first} to {r.last}" for r in ranges]
    more = ", …" if len(said) > _MOST_RANGES else ""
    return [f"images {', '.join(said[:_MOST_RANGES])}{more} are {light.value}"]


def _of_right_camera(found: RightCameraError) -> str:
    return (
        f"the right camera is not as calibrated ({found.in_words}); this has been corrected, but "
        "calibrate anew: vo calibrate"
    )


def _of_lens(found: LensError) -> str:
    amount = f"k1 off by {found.k1:+.4f}, {found.edge_px:+.1f} px at the image's edges"
    if abs(found.edge_px) < _BEYOND_LENS_PX:
        corrected = "this has been corrected, but calibrate anew"
    else:
        corrected = "one coefficient cannot correct all of that; the path is off: calibrate anew"
    return f"the lens is not as calibrated ({amount}); {corrected}: vo calibrate"


def _of_curve(curve_px: float) -> str:
    return (
        f"towards left and right disparities were off by up to {curve_px:+.2f} px (at one focal "
        "length from the image's middle, growing with the square) and have been corrected: the "
        "stereo calibration is slightly wrong"
    )


def _of_offset(offset_px: float) -> str:
    if abs(offset_px) < _BEYOND_TRUST_PX:
        return (
            f"all disparities were off by {offset_px:+.2f} px and have been corrected: the stereo "
            "calibration is slightly wrong"
        )
    return (
        f"all disparities seem to be off by {offset_px:+.2f} px: the stereo calibration is wrong, "
        "and so are all lengths; check focal length, baseline and image size (vo info shows them)"
    )
