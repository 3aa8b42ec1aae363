"""The samples of an inertial sensor between the times of frames."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from vo.inertial.preintegration import Interval
from vo.types import Floats, ImuNoise, Ints

_MAX_GAP_S = 0.1  # between samples; a longer one is not bridged by interpolation
_BLOCK_NS = 10_000_000_000  # of samples that are read at a time
_MARGIN_NS = 200_000_000


class Samples(Protocol):
    """Samples in the frame of the sensor: (n,) ns, (n, 3) rad/s, (n, 3) m/s²."""

    @property
    def stamps_ns(self) -> Ints:
        """Increasing."""
        ...

    @property
    def gyro(self) -> Floats:
        """Angular rates."""
        ...

    @property
    def accel(self) -> Floats:
        """Specific forces."""
        ...


class InertialSensor(Protocol):
    """An inertial sensor that is rigidly fixed to the cameras."""

    @property
    def name(self) -> str:
        """For messages."""
        ...

    @property
    def stamps_ns(self) -> Ints:
        """(N,) times of all samples, increasing."""
        ...

    @property
    def cam0_from_imu(self) -> Floats | None:
        """(4, 4), None if it is unknown."""
        ...

    @property
    def noise(self) -> ImuNoise | None:
        """None if it is unknown."""
        ...

    @property
    def time_offset_s(self) -> float:
        """What to add to the stamp of an image to get the same moment on the sensor's clock."""
        ...

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> Samples:
        """Samples of a range of times, both ends included."""
        ...


class RetimedSensor:
    """An inertial sensor whose time offset is replaced when it was measured.

    All readers of its samples follow.

    Attributes:
        time_offset_s: the newest one, at first that of the sensor.

    Args:
        sensor: gives everything else.
    """

    def __init__(self, sensor: InertialSensor) -> None:
        self._sensor = sensor
        self.time_offset_s = sensor.time_offset_s

    @property
    def given_offset_s(self) -> float:
        """That of the sensor."""
        return self._sensor.time_offset_s

    @property
    def name(self) -> str:
        """For messages."""
        return self._sensor.name

    @property
    def stamps_ns(self) -> Ints:
        """(N,) times of all samples, increasing."""
        return self._sensor.stamps_ns

    @property
    def cam0_from_imu(self) -> Floats | None:
        """(4, 4), None if it is unknown."""
        return self._sensor.cam0_from_imu

    @property
    def noise(self) -> ImuNoise | None:
        """None if it is unknown."""
        return self._sensor.noise

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> Samples:
        """Samples of a range of times, both ends included."""
        return self._sensor.read(first_ns, last_ns)


class SampleReader:
    """Hands out the samples between two times, interpolated at both; times mostly increase.

    Args:
        sensor: is read in blocks.
    """

    def __init__(self, sensor: InertialSensor) -> None:
        self._sensor = sensor
        self._begin = self._end = 0
        self._ends = (0, 0)
        self._interval: Interval | None = None  # between these
        self._samples: Samples | None = None

    def between(self, first_ns: int, last_ns: int) -> Interval | None:
        """Samples from the time of an image to a later one; None where samples are missing."""
        if last_ns <= first_ns:
            return None
        offset_ns = round(1e9 * self._sensor.time_offset_s)
        ends = first_ns + offset_ns, last_ns + offset_ns
        if self._ends != ends:  # predictions and what is learned of them ask for the same
            self._ends, self._interval = ends, self._read(*ends)
        return self._interval

    def _read(self, first_ns: int, last_ns: int) -> Interval | None:
        samples = self._block(first_ns, last_ns)
        stamps = samples.stamps_ns
        begin = int(np.searchsorted(stamps, first_ns, side="right")) - 1
        end = int(np.searchsorted(stamps, last_ns, side="left"))
        if begin < 0 or end >= len(stamps):
            return None
        if int(np.diff(stamps[begin : end + 1]).max(initial=0)) > _MAX_GAP_S * 1e9:
            return None
        inner = slice(begin + 1, end)
        times = np.concatenate([[first_ns], stamps[inner], [last_ns]])
        values = np.concatenate([samples.gyro[begin : end + 1], samples.accel[begin : end + 1]], 1)
        around = stamps[begin : end + 1]
        ends = [_interpolated(around, values, at) for at in (first_ns, last_ns)]
        rows = np.concatenate([ends[:1], values[1:-1], ends[1:]])
        return Interval(1e-9 * (times - first_ns), rows[:, :3], rows[:, 3:])

    def _block(self, first_ns: int, last_ns: int) -> Samples:
        if self._samples is None or first_ns < self._begin or last_ns > self._end:
            self._begin, self._end = first_ns, max(last_ns, first_ns + _BLOCK_NS)
            self._samples = self._sensor.read(self._begin - _MARGIN_NS, self._end + _MARGIN_NS)
        return self._samples


def _interpolated(stamps_ns: Ints, values: Floats, at_ns: int) -> Floats:
    """(6,) values at a time, linear between the samples beside it."""
    after = int(np.clip(np.searchsorted(stamps_ns, at_ns), 1, len(stamps_ns) - 1))
    begin, end = int(stamps_ns[after - 1]), int(stamps_ns[after])
    fraction = (at_ns - begin) / (end - begin)
    return np.asarray(values[after - 1] + fraction * (values[after] - values[after - 1]))
