"""Time offset between camera and inertial sensor, from the rotations of a run."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats, Ints
from vo.engine.geometry.gyro_alignment import GyroAlignment, Rotations, align_gyro
from vo.engine.geometry.so3 import log_rows
from vo.engine.inertial.samples import SampleReader

# Largest difference from the given offset, margin of the samples, and largest ratio of what is left
# of the rotations: farther away only what fits well (0.05 where it is right) is believed.
_SEARCHES = ((0.1, 200_000_000, 1.0), (0.5, 700_000_000, 0.2))
_MAX_INTERVAL_S = 0.2  # between two frames
_MAX_INTERVALS = 3000  # of a long run, every so many are left out
_MAX_TURN_RAD = np.radians(10.0)  # between the fitted rotation of the sensor and the given one
_MIN_CHANGE_S, _MIN_CHANGE_SIGMA = 0.001, 5.0
_MIN_DRIFT_S = 0.003  # between the halves of a run
_FIRST_FRAMES = 40  # after which the offset is measured first
_KNOWN_SIGMA_S = 0.001
_REGULAR_OVER = 31  # frames
_MIN_IRREGULAR_S, _MAX_IRREGULAR = 1e-4, 0.1  # standard deviation of stamps; relative to the period


class TimeOffset(NamedTuple):
    """A measured offset."""

    # what to add to the stamp of an image to get the same moment on the sensor's clock
    seconds: float
    sigma_s: float  # standard deviation

    def differs_from(self, given_s: float) -> bool:
        """Whether it is another one than the given offset, beyond doubt."""
        change = abs(self.seconds - given_s)
        return change > max(_MIN_CHANGE_S, _MIN_CHANGE_SIGMA * self.sigma_s)


def different_clocks(first: TimeOffset | None, second: TimeOffset | None) -> str | None:
    """That the offsets of both halves of a run differ, in words; None where they do not."""
    if first is None or second is None:
        return None
    change, sigma = second.seconds - first.seconds, math.hypot(first.sigma_s, second.sigma_s)
    if abs(change) <= max(_MIN_DRIFT_S, _MIN_CHANGE_SIGMA * sigma):
        return None
    return (
        f"its clock is {1e3 * first.seconds:+.1f} ms from that of the images in the first half of "
        f"the run, and {1e3 * second.seconds:+.1f} ms in the second: they run at different rates"
    )


class OffsetSearch:
    """Measures the time offset of a sensor during a run, and replaces it where it is wrong.

    Attributes:
        found: the newest measurement, None without.
    """

    def __init__(self, reader: SampleReader) -> None:
        self.found: TimeOffset | None = None
        self._reader = reader
        self._due = _FIRST_FRAMES
        self._is_over = False

    def is_due(self, frames: int, *, has_states: bool) -> bool:
        """Whether to measure now: rarely before the first states, and once when there are any."""
        if self._is_over or not (has_states or frames >= self._due):
            return False
        self._due = 2 * frames
        self._is_over = has_states
        return True

    def measure(self, stamps_ns: Ints, segments: Ints, rotations: Floats) -> bool:
        """Measure as `measure_time_offset` does; whether the offset in use is another one now."""
        self.found = measure_time_offset(stamps_ns, segments, rotations, self._reader)
        if self.found is None:
            return False
        self._is_over = self._is_over or self.found.sigma_s < _KNOWN_SIGMA_S
        used_s, given_s = self._reader.time_offset_s, self._reader.sensor.time_offset_s
        if used_s == given_s and not self.found.differs_from(given_s):
            return False  # one that was replaced before is refined
        self._reader.time_offset_s = self.found.seconds
        return True


def measure_time_offset(
    stamps_ns: Ints, segments: Ints, rotations: Floats, reader: SampleReader
) -> TimeOffset | None:
    """The offset with which the gyroscope repeats the rotations of the camera.

    Args:
        stamps_ns: (n,) times of frames, increasing.
        segments: (n,) numbers of their segments.
        rotations: (n, 3, 3) world_from_cam0 of each, by images alone.
        reader: of a sensor with known extrinsics.

    Returns:
        None if the camera turned too little, or if the gyroscope does not fit.

    Raises:
        SourceError: the samples cannot be read.
    """
    cam0_from_imu = reader.sensor.cam0_from_imu
    assert cam0_from_imu is not None
    steps = np.diff(stamps_ns)
    joined = (np.diff(segments) == 0) & (steps > 0) & (steps <= _MAX_INTERVAL_S * 1e9)
    first = np.flatnonzero(joined)
    if len(first) == 0:
        return None
    first = first[:: -(-len(first) // _MAX_INTERVALS)]
    relative = np.swapaxes(rotations[first], 1, 2) @ rotations[first + 1]
    given_ns = round(1e9 * reader.time_offset_s)
    begin, end = stamps_ns[first] + given_ns, stamps_ns[first + 1] + given_ns
    turned = Rotations(begin, end, log_rows(relative))
    for reach_s, margin_ns, most in _SEARCHES:
        samples = reader.sensor.read(int(begin[0]) - margin_ns, int(end[-1]) + margin_ns)
        found = align_gyro(turned, samples.stamps_ns, samples.gyro, reach_s)
        if found is None or found.residual_rad_s > most * found.signal_rad_s:
            continue
        if _fits(found, cam0_from_imu[:3, :3]):
            seconds = reader.time_offset_s + found.time_offset_s
            return TimeOffset(seconds, found.time_offset_sd_s)
    return None


def _fits(found: GyroAlignment, cam_from_imu: Floats) -> bool:
    """Whether the gyroscope has the orientation on the camera that is known."""
    if found.is_mirrored:
        return False
    if np.isfinite(found.rotation_sd_rad):
        cosine = 0.5 * (float(np.trace(found.cam_from_imu @ cam_from_imu.T)) - 1.0)
    else:  # about one axis only
        axis = found.main_axis
        cosine = float((found.cam_from_imu @ axis) @ (cam_from_imu @ axis))
    return cosine > float(np.cos(_MAX_TURN_RAD))


def regular_stamps(stamps_ns: Ints) -> Ints | None:
    """The same times at the regular rate of a camera whose stamps vary; None for others."""
    seconds = 1e-9 * (stamps_ns - stamps_ns[0])
    period_s = float(np.median(np.diff(seconds)))
    number = np.cumsum(np.r_[0.0, np.rint(np.diff(seconds) / period_s)])
    late_s = seconds - np.polyval(np.polyfit(number, seconds, 1), number)
    near = np.ones(min(_REGULAR_OVER, len(late_s)))  # rates drift
    late_s -= np.convolve(late_s, near, "same") / np.convolve(np.ones_like(late_s), near, "same")
    if not _MIN_IRREGULAR_S < float(late_s.std()) < _MAX_IRREGULAR * period_s:
        return None
    return np.asarray(stamps_ns - np.rint(1e9 * late_s).astype(np.int64))
