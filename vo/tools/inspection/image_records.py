"""Records about the images of a recording: stamps, quality, and agreement of a stereo pair."""

from __future__ import annotations

from dataclasses import dataclass

from vo.base.records.calibration_errors import RightCameraError


@dataclass(frozen=True)
class Gap:
    """A gap in the images of a camera.

    Attributes:
        missing: approximate number of missing images.
    """

    after_frame: int
    at_s: float
    seconds: float
    missing: int


@dataclass(frozen=True)
class Timing:
    """Statistics of the stamps of a camera.

    Attributes:
        span_s: time from the first to the last image.
        rate_hz: from the median interval; 0 with fewer than two images.
        jitter_ms: 95th percentile of deviations from the median interval, without gaps.
        gaps: intervals longer than 1.5 times the median.
        repeated_stamps: number of images not used because of a repeated stamp.
    """

    count: int
    first_ns: int
    span_s: float
    rate_hz: float
    jitter_ms: float
    gaps: tuple[Gap, ...]
    repeated_stamps: int = 0


@dataclass(frozen=True)
class ImageStatistics:
    """Statistics of a checked image.

    Attributes:
        frame: frame number.
        mean_grey: mean grey value, 0 to 255.
        dark: fraction of pixels below 10.
        bright: fraction of pixels above 250.
        blur: blur measure, 0 sharp to 1 without detail.
        corners: number of FAST corners.
        repeats: whether it equals the previous image; None if that was not read.
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
    """Stamps of a camera, and its checked images.

    Attributes:
        name: `cam0`, `cam1` or a topic.
        width: width of the first readable image in pixels; 0 without one.
        height: height of the same.
        bits: bits per pixel, 8 or 16.
        unreadable: frame numbers of unreadable images among the checked ones.
        other_sizes: frame numbers of images of other sizes.
    """

    name: str
    timing: Timing
    width: int
    height: int
    bits: int
    has_colour: bool
    looks: tuple[ImageStatistics, ...]
    unreadable: tuple[int, ...]
    other_sizes: tuple[int, ...]


@dataclass(frozen=True)
class PairReport:
    """Pairing of left and right images by stamp.

    Attributes:
        offset_ms: median of right stamp minus left stamp.
        offsets_ms: smallest and largest offset.
        histogram: number of pairs by offset in milliseconds (lower edge of the bin).
        tolerance_ms: largest offset of a pair.
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
    """Comparison of left and right images.

    Attributes:
        row_offset_px: mean of row in the right image minus row in the left one.
        row_spread_px: standard deviation of the same.
        positive: fraction of points with positive disparity, as expected.
        disparity_px: median disparity.
        depth_m: depth of that disparity; None without calibration.
        right_camera: error of the right camera's calibration, if significant.
        is_same_camera: whether both images are of the same camera.
        are_exchanged: whether disparities are negative, and too large for a turned camera.
        time_offset_ms: time at which right images were taken minus that of left ones of the same
            stamp, None unless the motion shows one.
        right_is: how the right image is mirrored or turned against the left one; the other values
            are then those of the reverted image. Empty if it is not.
    """

    rectified: bool
    pairs: int
    matches: int
    row_offset_px: float
    row_spread_px: float
    positive: float
    disparity_px: float
    depth_m: float | None
    right_camera: RightCameraError | None = None
    is_same_camera: bool = False
    are_exchanged: bool = False
    right_is: str = ""
    time_offset_ms: float | None = None
