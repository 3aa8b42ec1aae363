"""The samples of an inertial sensor between the times of frames."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from vo.base.types import Bools, Floats, ImuNoise, Ints
from vo.engine.inertial.preintegration import Interval
from vo.engine.inertial.sample_checks import refused_samples

_MAX_GAP_S = 0.1  # between samples; a longer one is not bridged by interpolation
_BLOCK_NS = 10_000_000_000  # of samples that are read at a time
_EARLIER_NS = 5_000_000_000  # keyframes are asked for after the frames that follow them
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
        """(N,) times of all samples, increasing; of a program's sensor, of those that came."""
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


class SampleReader:
    """Hands out the good samples between two times of images, interpolated at both.

    All users of a sensor share one, whose time offset is replaced when it was measured.

    Attributes:
        sensor: is read in blocks.
        time_offset_s: the newest one, at first that of the sensor.
    """

    def __init__(self, sensor: InertialSensor) -> None:
        self.sensor = sensor
        self.time_offset_s = sensor.time_offset_s
        self._begin = self._end = 0
        self._ends = (0, 0)
        self._interval: Interval | None = None  # between these
        self._block: _Block | None = None
        self._known = 0  # samples that the sensor had when the block was read

    def between(self, first_ns: int, last_ns: int) -> Interval | None:
        """Samples from the time of an image to a later one; None where samples are missing."""
        if last_ns <= first_ns:
            return None
        offset_ns = round(1e9 * self.time_offset_s)
        ends = first_ns + offset_ns, last_ns + offset_ns
        # Predictions and what is learned of them ask for the same. What is missing may come.
        if self._ends != ends or self._interval is None:
            self._ends, self._interval = ends, self._read(*ends)
        return self._interval

    def _read(self, first_ns: int, last_ns: int) -> Interval | None:
        block = self._block_of(first_ns, last_ns)
        stamps = block.stamps_ns
        begin = int(stamps.searchsorted(first_ns, side="right")) - 1
        end = int(stamps.searchsorted(last_ns, side="left"))
        if begin < 0 or end >= len(stamps):
            return None
        around, values = stamps[begin : end + 1], block.values[begin : end + 1]
        if int((around[1:] - around[:-1]).max()) > _MAX_GAP_S * 1e9:
            return None
        rows = values.copy()
        rows[0] = _interpolated(around[:2], values[:2], first_ns)
        rows[-1] = _interpolated(around[-2:], values[-2:], last_ns)
        seconds: Floats = 1e-9 * (around - first_ns).astype(np.float64)
        seconds[0], seconds[-1] = 0.0, 1e-9 * (last_ns - first_ns)
        bridged_s = 0.0 if block.refused is None else block.refused.bridged_s(first_ns, last_ns)
        return Interval(seconds, rows[:, :3], rows[:, 3:], bridged_s)

    def _block_of(self, first_ns: int, last_ns: int) -> _Block:
        is_inside = self._begin <= first_ns and last_ns <= self._end
        if self._block is None or not is_inside or self._has_more(self._block, last_ns):
            self._known = len(self.sensor.stamps_ns)
            self._begin = first_ns - _EARLIER_NS
            self._end = max(last_ns, first_ns + _BLOCK_NS)
            read = self.sensor.read(self._begin - _MARGIN_NS, self._end + _MARGIN_NS)
            values = np.concatenate([read.gyro, read.accel], axis=1)
            refused = refused_samples(read.stamps_ns, values)
            if refused is None:
                self._block = _Block(read.stamps_ns, values)
            else:
                gaps = _Refused.of(read.stamps_ns, refused)
                self._block = _Block(read.stamps_ns[~refused], values[~refused], gaps)
        return self._block

    def _has_more(self, block: _Block, last_ns: int) -> bool:
        """Whether a block ends too early, and samples came since it was read."""
        ends_before = not len(block.stamps_ns) or int(block.stamps_ns[-1]) < last_ns
        return ends_before and len(self.sensor.stamps_ns) > self._known


class _Refused(NamedTuple):
    """Gaps that refused samples leave: times (n,) of the good samples before and after."""

    before_ns: Ints
    after_ns: Ints

    @classmethod
    def of(cls, stamps_ns: Ints, refused: Bools) -> _Refused:
        edges = np.flatnonzero(np.diff(np.r_[False, refused, False].astype(np.int8)))
        begin, end = edges.reshape(-1, 2).T
        last = len(stamps_ns) - 1
        return cls(stamps_ns[(begin - 1).clip(0)], stamps_ns[end.clip(None, last)])

    def bridged_s(self, first_ns: int, last_ns: int) -> float:
        """Time between two times that lies in gaps."""
        begin, end = self.before_ns.clip(first_ns, last_ns), self.after_ns.clip(first_ns, last_ns)
        return 1e-9 * float((end - begin).sum())


class _Block(NamedTuple):
    """Good samples that were read together: times (n,), and rates and forces (n, 6)."""

    stamps_ns: Ints
    values: Floats
    refused: _Refused | None = None


def _interpolated(stamps_ns: Ints, values: Floats, at_ns: int) -> Floats:
    """(6,) values at a time, linear between two samples (2, 6)."""
    begin, end = stamps_ns.tolist()
    fraction = (at_ns - begin) / (end - begin)
    return np.asarray(values[0] + fraction * (values[1] - values[0]))
