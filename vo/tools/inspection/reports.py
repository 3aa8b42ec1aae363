"""Records of an inspection; their fields are the keys of `vo info --json`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vo.tools.inspection.image_records import CameraReport, PairReport, StereoReport

Level = Literal["error", "warning", "note"]
Place = Literal["right", "below", "left", "above", "in front", "behind"]


@dataclass(frozen=True)
class TopicReport:
    """A topic of a log."""

    name: str  # name, such as `/cam0/image_raw`
    schema: str
    kind: str  # type of message in `vo`; empty if it is not read
    count: int
    rate_hz: float  # messages per second; 0 if unknown
    is_read: bool = True  # whether `vo` reads messages of this type


@dataclass(frozen=True)
class LensReport:
    """Calibration of a camera, in figures that can be compared with its data sheet."""

    name: str  # `cam0`, `cam1`, …
    width: int  # image width in pixels
    height: int  # image height in pixels
    fx: float  # focal length in pixels, along u
    fy: float  # focal length in pixels, along v
    cx: float  # principal point, u
    cy: float  # principal point, v
    model: str
    # Horizontal and vertical field of view; None outside the range of the lens model
    view_deg: tuple[float | None, float | None]
    # Time from the first to the last row of an image; 0 for a global shutter
    readout_s: float = 0.0


@dataclass(frozen=True)
class MountReport:
    """How a camera of a rig is mounted, and what others see of its image."""

    name: str
    from_cam0_m: float
    turned_deg: float  # angle of its optical axis to that of cam0
    # Ratio of its image that others see too, at 1 to 30 m, by their names; at least 3 % of both
    overlaps: dict[str, float]


@dataclass(frozen=True)
class CalibrationReport:
    """Calibration of all cameras."""

    lenses: tuple[LensReport, ...]
    baseline_m: float | None  # distance between the cameras; None with one camera
    is_rectified: bool | None  # whether the images are rectified already; None with one camera
    # Where cam1 is, seen from cam0: right, below, left, above, in front or behind; None with one
    # camera
    cam1_is: Place | None = None
    cam1_turned_deg: float | None = None  # rotation between the cameras; None with one camera
    source: str = ""  # its file and format; empty if it is part of a log
    mounts: tuple[MountReport, ...] = ()  # the cameras of a rig


@dataclass(frozen=True)
class TruthReport:
    """Ground truth poses."""

    poses: int
    span_s: float  # time from the first to the last
    rate_hz: float  # from the median interval
    path_m: float
    # Fraction of the left images between the first and the last pose in time; None without images
    covered: float | None


@dataclass(frozen=True)
class ImuMotionReport:
    """Rotation of the images compared with the gyroscope."""

    compared: int
    fits: bool  # whether both measure the same rotation
    # What to add to the stamp of an image to get the same moment on the clock of the sensor; None
    # if they do not fit
    time_offset_ms: float | None
    time_offset_sd_ms: float | None
    given_offset_ms: float  # the offset in the calibration, 0 without one
    # Rows of the (3, 3) rotation that fits; None if they do not fit
    cam0_from_imu_rotation: list[list[float]] | None
    # Angle between this rotation and that of the calibration; None without either. If all rotations
    # are about one axis, the angle between its directions
    rotation_error_deg: float | None
    inverse_error_deg: float | None  # the same for the inverse of the calibration
    is_mirrored: bool  # whether the axes of the gyroscope form a left-handed frame
    rate_ratio: float  # angular rate of the gyroscope relative to that of the images


@dataclass(frozen=True)
class ImuReport:
    """An inertial sensor; figures of values are those of the checked samples."""

    name: str
    count: int
    first_ns: int
    span_s: float  # time from the first to the last sample
    rate_hz: float  # from the median interval
    gaps: int  # number of intervals longer than 2.5 times the median
    longest_gap_s: float  # longest of them; 0 without gaps
    looked_at: int
    unreadable: int  # number of damaged or non-finite ones among them
    accel_m_s2: float  # mean norm of the specific force; about 9.81
    gyro_rad_s: float  # median norm of the angular rate
    gyro_high_rad_s: float  # 99th percentile of the same
    # Fraction of the left images during its measurements; None without images
    covered: float | None
    cam0_from_imu: list[list[float]] | None  # rows of the (4, 4) transform; None if unknown
    # Mean specific force in the frame of cam0; None if its pose is unknown
    accel_cam0: list[float] | None = None
    gyro_saturated: float = 0.0  # fraction of samples at the end of the range of the gyroscope
    accel_saturated: float = 0.0
    clock_ahead_s: float | None = None  # first sample minus first image; None without images
    # Comparison with the images, of the first sensor only; None without one
    motion: ImuMotionReport | None = None
    # Densities and random walks, as in `vo.base.types.ImuNoise`; None if unknown
    noise: dict[str, float] | None = None


@dataclass(frozen=True)
class Finding:
    """A problem or remark."""

    level: Level
    what: str
    advice: str = ""  # what to do about it; may be empty


@dataclass(frozen=True)
class Report:
    """Results of an inspection."""

    path: str
    format: str
    topics: tuple[TopicReport, ...]  # topics of a log, those that are read first
    imu: tuple[ImuReport, ...]
    cameras: tuple[CameraReport, ...]  # those of the rig, or all candidates
    pair: PairReport | None  # pairing of left and right images; None without a pair
    calibration: CalibrationReport | None  # the calibration, if there is one
    stereo: StereoReport | None  # comparison of left and right images; None without checked pairs
    truth: TruthReport | None  # the ground truth, if there is one
    # Topics of a log with poses, and `TOPIC:PARENT:CHILD` of frames that move
    pose_topics: tuple[str, ...]
    has_depth: bool  # whether frames have depth images
    clip: tuple[str, ...]  # of a video or photographs: what the camera says of itself
    findings: tuple[Finding, ...]  # problems and remarks, the most serious first
    command: str  # command to try next; empty if none can work yet
