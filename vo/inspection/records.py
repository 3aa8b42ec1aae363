"""What is found out about a recording, in plain numbers and words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vo.types import RightCamera

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class TopicLine:
    """A topic of a log.

    Attributes:
        name: such as `/cam0/image_raw`.
        schema: name of its kind of message, as stored.
        kind: what it is here; empty where nobody reads it.
        rate_hz: messages in a second; 0 where that is not known.
        is_read: whether it is of any use here.
    """

    name: str
    schema: str
    kind: str
    count: int
    rate_hz: float
    is_read: bool = True


@dataclass(frozen=True)
class Gap:
    """A place where images are missing.

    Attributes:
        after_frame: the last image before it.
        at_s: its time since the first image.
        seconds: until the next image.
        missing: about how many images should be there.
    """

    after_frame: int
    at_s: float
    seconds: float
    missing: int


@dataclass(frozen=True)
class Timing:
    """The stamps of a camera.

    Attributes:
        count: images.
        first_ns: stamp of the first.
        span_s: from the first to the last.
        rate_hz: from the median interval; 0 with fewer than two images.
        jitter_ms: 95 % of the intervals are no further from the median; without gaps.
        gaps: intervals longer than 1.5 times the median.
        repeated_stamps: images that are not used, as their stamp was there before.
    """

    count: int
    first_ns: int
    span_s: float
    rate_hz: float
    jitter_ms: float
    gaps: tuple[Gap, ...]
    repeated_stamps: int = 0


@dataclass(frozen=True)
class Look:
    """One image that was looked at.

    Attributes:
        frame: its number.
        mean_grey: 0 to 255.
        dark: share of its pixels below 10.
        bright: share of its pixels above 250.
        blur: 0 is sharp, 1 has no detail.
        corners: of FAST.
        repeats: whether it is pixel for pixel the image before; None where that was not looked at.
    """

    frame: int
    mean_grey: float
    dark: float
    bright: float
    blur: float
    corners: int
    repeats: bool | None


@dataclass(frozen=True)
class CameraReport:
    """A camera: its stamps and the images that were looked at.

    Attributes:
        name: `cam0`, `cam1` or a topic.
        timing: of all its images.
        width: of the first image that can be read, in pixels; 0 where none can.
        height: of the same.
        bits: 8 or 16 per pixel.
        has_colour: whether its first image that can be read has.
        looks: the images that were looked at.
        unreadable: frames of which the image cannot be read, of those that were looked at.
        other_sizes: frames whose image has another size.
    """

    name: str
    timing: Timing
    width: int
    height: int
    bits: int
    has_colour: bool
    looks: tuple[Look, ...]
    unreadable: tuple[int, ...]
    other_sizes: tuple[int, ...]


@dataclass(frozen=True)
class PairReport:
    """Left and right in time.

    Attributes:
        pairs: left images with a right one.
        left_alone: left images without.
        right_alone: right images without.
        offset_ms: median of right stamp minus left stamp.
        offsets_ms: smallest and largest.
        histogram: how many pairs, by offset in milliseconds (lower edge of the bin).
        tolerance_ms: how far apart a pair may be.
    """

    pairs: int
    left_alone: int
    right_alone: int
    offset_ms: float
    offsets_ms: tuple[float, float]
    histogram: tuple[tuple[float, int], ...]
    tolerance_ms: float


@dataclass(frozen=True)
class StereoReport:
    """What left and right images say about the pair.

    Attributes:
        rectified: whether this is of rectified images, or of those that were recorded.
        pairs: of images that were compared.
        matches: points found in both.
        row_offset_px: mean of row in the right image minus row in the left one.
        row_spread_px: standard deviation around it.
        positive: share of points that lie further left in the right image, as they should.
        disparity_px: their median disparity.
        depth_m: what that means with the calibration; None without one.
        right_camera: how the right camera differs from its calibration, if rows say that it does.
    """

    rectified: bool
    pairs: int
    matches: int
    row_offset_px: float
    row_spread_px: float
    positive: float
    disparity_px: float
    depth_m: float | None
    right_camera: RightCamera | None = None


@dataclass(frozen=True)
class LensReport:
    """A camera's calibration in words that can be checked with a glance at the camera.

    Attributes:
        name: `cam0` or `cam1`.
        width: of the images it is for.
        height: of the same.
        fx: focal length in pixels, along u.
        fy: the same along v.
        cx: principal point, u.
        cy: principal point, v.
        model: of the distortion.
        view_deg: horizontal and vertical field of view; None where the lens model does not reach.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: str
    view_deg: tuple[float | None, float | None]


@dataclass(frozen=True)
class CalibrationReport:
    """The cameras and their distance."""

    lenses: tuple[LensReport, ...]
    baseline_m: float | None
    is_rectified: bool | None


@dataclass(frozen=True)
class TruthReport:
    """True poses.

    Attributes:
        poses: how many.
        span_s: from the first to the last.
        rate_hz: from the median interval.
        path_m: length of the path.
        covered: share of the left images whose time lies between the first and the last pose.
    """

    poses: int
    span_s: float
    rate_hz: float
    path_m: float
    covered: float


@dataclass(frozen=True)
class ImuReport:
    """An inertial sensor; what is said of values is of those that were looked at.

    Attributes:
        name: its topic, table or folder.
        count: samples.
        first_ns: stamp of the first.
        span_s: from the first to the last.
        rate_hz: from the median interval.
        gaps: intervals longer than 2.5 times the median.
        longest_gap_s: the longest of them; 0 where there is none.
        looked_at: samples whose values were looked at.
        unreadable: of these, those that are damaged or not finite.
        accel_m_s2: mean of the specific force's length; about 9.81.
        gyro_rad_s: median of the rate's length.
        gyro_high_rad_s: 99 % of the lengths are below.
        covered: share of the left images taken while it measured; None without images.
        cam0_from_imu: rows of the (4, 4) transform; None where nothing says where it is.
    """

    name: str
    count: int
    first_ns: int
    span_s: float
    rate_hz: float
    gaps: int
    longest_gap_s: float
    looked_at: int
    unreadable: int
    accel_m_s2: float
    gyro_rad_s: float
    gyro_high_rad_s: float
    covered: float | None
    cam0_from_imu: list[list[float]] | None


@dataclass(frozen=True)
class Finding:
    """Something that is wrong or worth knowing, and what to do about it."""

    level: Level
    what: str
    advice: str = ""


@dataclass(frozen=True)
class Report:
    """All that is known of a recording.

    Attributes:
        path: as given.
        format: name in the registry.
        topics: of a log; those that are read come first.
        imu: inertial sensors, the one to use first.
        cameras: left and right, or all that come into question.
        pair: left and right in time; None unless there are both.
        calibration: None where there is none.
        stereo: None where no pair was looked at.
        truth: None where there is none.
        has_depth: whether frames come with depth.
        findings: the most serious first.
        command: to try next.
    """

    path: str
    format: str
    topics: tuple[TopicLine, ...]
    imu: tuple[ImuReport, ...]
    cameras: tuple[CameraReport, ...]
    pair: PairReport | None
    calibration: CalibrationReport | None
    stereo: StereoReport | None
    truth: TruthReport | None
    has_depth: bool
    findings: tuple[Finding, ...]
    command: str
