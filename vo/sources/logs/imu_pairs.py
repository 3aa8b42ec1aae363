"""Gyroscope and accelerometer with a topic each, as RealSense cameras have them, as one sensor."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from vo.sources.imu import Imu, ImuSamples, rows_between
from vo.sources.logs.imu import LogImu
from vo.sources.logs.log import Log, Topic
from vo.types import Floats, ImuNoise, Ints

_GYRO = re.compile(r"(?<![a-z])gyro(?![a-z])")


class PairedImu:
    """An `Imu` of two topics: accelerations are interpolated at the times of the rates."""

    def __init__(self, gyro: LogImu, accel: LogImu) -> None:
        """Join two sensors that do not move towards each other."""
        self.name = f"{gyro.name} with {accel.name}"
        self.noise: ImuNoise | None = None
        self._gyro = gyro
        self._accel = accel

    @property
    def stamps_ns(self) -> Ints:
        """As `Imu.stamps_ns`: those of the gyroscope that lie between two accelerations."""
        all_ns, known_ns = self._gyro.stamps_ns, self._accel.stamps_ns
        if not len(known_ns):
            return all_ns[:0]
        return all_ns[rows_between(all_ns, int(known_ns[0]), int(known_ns[-1]))]

    @property
    def cam0_from_imu(self) -> Floats | None:
        """As `Imu.cam0_from_imu`: where the gyroscope is."""
        return self._gyro.cam0_from_imu

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """As `Imu.read`; samples that are damaged are warned of."""
        wanted = self.stamps_ns[rows_between(self.stamps_ns, first_ns, last_ns)]
        if not len(wanted):
            return ImuSamples(wanted, np.empty((0, 3)), np.empty((0, 3)))
        known_ns = self._accel.stamps_ns
        before = int(np.searchsorted(known_ns, wanted[0], side="right")) - 1
        after = int(np.searchsorted(known_ns, wanted[-1]))
        accel = self._accel.read(int(known_ns[before]), int(known_ns[after]))
        return _joined(self._gyro.read(int(wanted[0]), int(wanted[-1])), accel)

    def read_some(self, most: int) -> ImuSamples:
        """As `Imu.read_some`: a stretch from the middle."""
        stamps = self.stamps_ns
        if len(stamps) <= most:
            return self.read()
        start = (len(stamps) - most) // 2
        return self.read(int(stamps[start]), int(stamps[start + most - 1]))


def _joined(gyro: ImuSamples, accel: ImuSamples) -> ImuSamples:
    stamps, unreadable = gyro.stamps_ns, gyro.unreadable + accel.unreadable
    if len(accel) == 0:
        return ImuSamples(stamps[:0], gyro.gyro[:0], gyro.accel[:0], unreadable)
    # Counted from the first, as a double has no room for nanoseconds since 1970.
    times, known = stamps - stamps[:1], accel.stamps_ns - stamps[:1]
    columns = [np.interp(times, known, axis) for axis in accel.accel.T]
    return ImuSamples(stamps, gyro.gyro, np.stack(columns, axis=1), unreadable)


def log_imus(log: Log, topics: Sequence[Topic], place: Callable[[str], Floats | None]) -> list[Imu]:
    """The inertial sensors of a log, in the order of their topics; what belongs together is joined.

    Args:
        log: the messages.
        topics: of inertial sensors.
        place: given a sensor's frame, cam0_from_imu or None.
    """
    single = {topic.name: LogImu(log, topic, place) for topic in topics}
    partners = {name: _GYRO.sub("accel", name) for name in single if _GYRO.search(name)}
    partners = {gyro: accel for gyro, accel in partners.items() if accel in single}
    return [
        PairedImu(imu, single[partners[name]]) if name in partners else imu
        for name, imu in single.items()
        if name not in partners.values()
    ]
