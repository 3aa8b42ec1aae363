"""Records of an inspection; their fields are the keys of `vo info --json`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vo.tools.inspection.image_records import CameraReport, PairReport, StereoReport

Level = Literal["error", "warning", "note"]
Place = Literal["right", "below", "left", "above", "in front", "behind"]


@dataclass(frozen=True)
class TopicReport:
    """A topic of a log.

    Attributes:
        name: name, such as `/cam0/image_raw`.
        kind: type of message in `vo`; empty if it is not read.
        rate_hz: messages per second; 0 if unknown.
        is_read: whether `vo` reads messages of this type.
    """

    name: str
    schema: str
    kind: str
    count: int
    rate_hz: float
    is_read: bool = True


@dataclass(frozen=True)
class LensReport:
    """Calibration of a camera, in figures that can be compared with its data sheet.

    Attributes:
        name: `cam0` or `cam1`.
        width: image width in pixels.
        height: image height in pixels.
        fx: focal length in pixels, along u.
        fy: focal length in pixels, along v.
        cx: principal point, u.
        cy: principal point, v.
        readout_s: time from the first to the last row of an image; 0 for a global shutter.
        view_deg: horizontal and vertical field of view; None outside the range of the lens model.
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
    readout_s: float = 0.0


@dataclass(frozen=True)
class CalibrationReport:
    """Calibration of all cameras.

    Attributes:
        baseline_m: distance between the cameras; None with one camera.
        is_rectified: whether the images are rectified already; None with one camera.
        cam1_is: where cam1 is, seen from cam0: right, below, left, above, in front or behind; None
            with one camera.
        cam1_turned_deg: rotation between the cameras; None with one camera.
        source: its file and format; empty if it is part of a log.
    """

    lenses: tuple[LensReport, ...]
    baseline_m: float | None
    is_rectified: bool | None
    cam1_is: Place | None = None
    cam1_turned_deg: float | None = None
    source: str = ""


@dataclass(frozen=True)
class TruthReport:
    """Ground truth poses.

    Attributes:
        span_s: time from the first to the last.
        rate_hz: from the median interval.
        covered: fraction of the left images between the first and the last pose in time; None
            without images.
    """

    poses: int
    span_s: float
    rate_hz: float
    path_m: float
    covered: float | None


@dataclass(frozen=True)
class ImuMotionReport:
    """Rotation of the images compared with the gyroscope.

    Attributes:
        fits: whether both measure the same rotation.
        time_offset_ms: what to add to the stamp of an image to get the same moment on the clock of
            the sensor; None if they do not fit.
        time_offset_sd_ms: its standard deviation.
        given_offset_ms: the offset in the calibration, 0 without one.
        cam0_from_imu_rotation: rows of the (3, 3) rotation that fits; None if they do not fit.
        rotation_error_deg: angle between this rotation and that of the calibration; None without
            either. If all rotations are about one axis, the angle between its directions.
        inverse_error_deg: the same for the inverse of the calibration.
        is_mirrored: whether the axes of the gyroscope form a left-handed frame.
        rate_ratio: angular rate of the gyroscope relative to that of the images.
    """

    compared: int
    fits: bool
    time_offset_ms: float | None
    time_offset_sd_ms: float | None
    given_offset_ms: float
    cam0_from_imu_rotation: list[list[float]] | None
    rotation_error_deg: float | None
    inverse_error_deg: float | None
    is_mirrored: bool
    rate_ratio: float


@dataclass(frozen=True)
class ImuReport:
    """An inertial sensor; figures of values are those of the checked samples.

    Attributes:
        span_s: time from the first to the last sample.
        rate_hz: from the median interval.
        gaps: number of intervals longer than 2.5 times the median.
        longest_gap_s: longest of them; 0 without gaps.
        unreadable: number of damaged or non-finite ones among them.
        accel_m_s2: mean norm of the specific force; about 9.81.
        gyro_rad_s: median norm of the angular rate.
        gyro_high_rad_s: 99th percentile of the same.
        covered: fraction of the left images during its measurements; None without images.
        cam0_from_imu: rows of the (4, 4) transform; None if unknown.
        accel_cam0: mean specific force in the frame of cam0; None if its pose is unknown.
        gyro_saturated: fraction of samples at the end of the range of the gyroscope.
        accel_saturated: the same of the accelerometer.
        clock_ahead_s: first sample minus first image; None without images.
        motion: comparison with the images, of the first sensor only; None without one.
        noise: densities and random walks, as in `vo.base.types.ImuNoise`; None if unknown.
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
    accel_cam0: list[float] | None = None
    gyro_saturated: float = 0.0
    accel_saturated: float = 0.0
    clock_ahead_s: float | None = None
    motion: ImuMotionReport | None = None
    noise: dict[str, float] | None = None


@dataclass(frozen=True)
class Finding:
    """A problem or remark.

    Attributes:
        advice: what to do about it; may be empty.
    """

    level: Level
    what: str
    advice: str = ""


@dataclass(frozen=True)
class Report:
    """Results of an inspection.

    Attributes:
        topics: topics of a log, those that are read first.
        cameras: left and right camera, or all candidates.
        pair: pairing of left and right images; None without a pair.
        calibration: the calibration, if there is one.
        stereo: comparison of left and right images; None without checked pairs.
        truth: the ground truth, if there is one.
        pose_topics: topics of a log with poses, and `TOPIC:PARENT:CHILD` of frames that move.
        has_depth: whether frames have depth images.
        findings: problems and remarks, the most serious first.
        command: command to try next; empty if none can work yet.
    """

    path: str
    format: str
    topics: tuple[TopicReport, ...]
    imu: tuple[ImuReport, ...]
    cameras: tuple[CameraReport, ...]
    pair: PairReport | None
    calibration: CalibrationReport | None
    stereo: StereoReport | None
    truth: TruthReport | None
    pose_topics: tuple[str, ...]
    has_depth: bool
    findings: tuple[Finding, ...]
    command: str
