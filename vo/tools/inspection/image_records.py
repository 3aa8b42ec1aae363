"""Records about the images of a recording: stamps, quality, and agreement of a stereo pair."""

from __future__ import annotations

from dataclasses import dataclass

from vo.base.records.calibration_errors import RightCameraError


@dataclass(frozen=True)
class Gap:
    """A gap in the images of a camera."""

    after_frame: int
    at_s: float
    seconds: float
    missing: int  # approximate number of missing images


@dataclass(frozen=True)
class Timing:
    """Statistics of the stamps of a camera."""

    count: int
    first_ns: int
    span_s: float  # time from the first to the last image
    rate_hz: float  # from the median interval; 0 with fewer than two images
    jitter_ms: float  # 95th percentile of deviations from the median interval, without gaps
    gaps: tuple[Gap, ...]  # intervals longer than 1.5 times the median
    repeated_stamps: int = 0  # number of images not used because of a repeated stamp


@dataclass(frozen=True)
class ImageStatistics:
    """Statistics of a checked image."""

    frame: int  # frame number
    mean_grey: float  # mean grey value, 0 to 255
    dark: float  # fraction of pixels below 10
    bright: float  # fraction of pixels above 250
    blur: float  # blur measure, 0 sharp to 1 without detail
    corners: int  # number of FAST corners
    repeats: bool | None  # whether it equals the previous image; None if that was not read


@dataclass(frozen=True)
class CameraReport:
    """Stamps of a camera, and its checked images."""

    name: str  # `cam0`, `cam1` or a topic
    timing: Timing
    width: int  # width of the first readable image in pixels; 0 without one
    height: int
    bits: int  # bits per pixel, 8 or 16
    has_colour: bool
    looks: tuple[ImageStatistics, ...]
    unreadable: tuple[int, ...]  # frame numbers of unreadable images among the checked ones
    other_sizes: tuple[int, ...]  # frame numbers of images of other sizes


@dataclass(frozen=True)
class PairReport:
    """Pairing of left and right images by stamp."""

    pairs: int
    left_alone: int
    right_alone: int
    offset_ms: float  # median of right stamp minus left stamp
    offsets_ms: tuple[float, float]  # smallest and largest offset
    # Number of pairs by offset in milliseconds (lower edge of the bin)
    histogram: tuple[tuple[float, int], ...]
    tolerance_ms: float  # largest offset of a pair


@dataclass(frozen=True)
class StereoReport:
    """Comparison of left and right images."""

    rectified: bool
    pairs: int
    matches: int
    row_offset_px: float  # mean of row in the right image minus row in the left one
    row_spread_px: float  # standard deviation of the same
    positive: float  # fraction of points with positive disparity, as expected
    disparity_px: float  # median
    depth_m: float | None  # depth of that disparity; None without calibration
    # Error of the right camera's calibration, if significant
    right_camera: RightCameraError | None = None
    is_same_camera: bool = False  # whether both images are of the same camera
    # Whether disparities are negative, and too large for a turned camera
    are_exchanged: bool = False
    # How the right image is mirrored or turned against the left one; the other values are then
    # those of the reverted image. Empty if it is not
    right_is: str = ""
    # Time at which right images were taken minus that of left ones of the same stamp, None unless
    # the motion shows one
    time_offset_ms: float | None = None
