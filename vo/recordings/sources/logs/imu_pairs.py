"""Gyroscope and accelerometer on separate topics, as of RealSense cameras, joined to one sensor."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from vo.base.types import Floats, ImuNoise, Ints
from vo.recordings.formats.calibration import ImuCalibration
from vo.recordings.sources.imu import Imu, ImuSamples, time_slice
from vo.recordings.sources.logs.imu import LogImu
from vo.recordings.sources.logs.log import Log, Topic

_GYRO = re.compile(r"(?<![a-z])gyro(?![a-z])")


class PairedImu:
    """An `Imu` of two topics; accelerations are interpolated at the stamps of the gyroscope."""

    def __init__(self, gyro: LogImu, accel: LogImu) -> None:
        """Join two sensors that are rigidly connected."""
        self.name = f"{gyro.name} with {accel.name}"
        self.noise: ImuNoise | None = gyro.noise
        self.time_offset_s = gyro.time_offset_s
        self._gyro = gyro
        self._accel = accel

    @property
    def stamps_ns(self) -> Ints:
        """See `Imu.stamps_ns`: stamps of the gyroscope between two accelerations."""
        gyro_ns, accel_ns = self._gyro.stamps_ns, self._accel.stamps_ns
        if not len(accel_ns):
            return gyro_ns[:0]
        return gyro_ns[time_slice(gyro_ns, int(accel_ns[0]), int(accel_ns[-1]))]

    @property
    def cam0_from_imu(self) -> Floats | None:
        """See `Imu.cam0_from_imu`: pose of the gyroscope."""
        return self._gyro.cam0_from_imu

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """See `Imu.read`; damaged samples cause a warning."""
        stamps_ns = self.stamps_ns[time_slice(self.stamps_ns, first_ns, last_ns)]
        if not len(stamps_ns):
            return ImuSamples(stamps_ns, np.empty((0, 3)), np.empty((0, 3)))
        accel_ns = self._accel.stamps_ns
        before = int(np.searchsorted(accel_ns, stamps_ns[0], side="right")) - 1
        after = int(np.searchsorted(accel_ns, stamps_ns[-1]))
        accel = self._accel.read(int(accel_ns[before]), int(accel_ns[after]))
        return _joined(self._gyro.read(int(stamps_ns[0]), int(stamps_ns[-1])), accel)

    def read_some(self, max_samples: int) -> ImuSamples:
        """See `Imu.read_some`: one part from the middle."""
        stamps = self.stamps_ns
        if len(stamps) <= max_samples:
            return self.read()
        start = (len(stamps) - max_samples) // 2
        return self.read(int(stamps[start]), int(stamps[start + max_samples - 1]))


def _joined(gyro: ImuSamples, accel: ImuSamples) -> ImuSamples:
    stamps, unreadable = gyro.stamps_ns, gyro.unreadable + accel.unreadable
    if len(accel) == 0:
        return ImuSamples(stamps[:0], gyro.gyro[:0], gyro.accel[:0], unreadable)
    # Relative to the first stamp, because a float64 cannot represent nanoseconds since 1970.
    times, accel_times = stamps - stamps[:1], accel.stamps_ns - stamps[:1]
    columns = [np.interp(times, accel_times, axis) for axis in accel.accel.T]
    return ImuSamples(stamps, gyro.gyro, np.stack(columns, axis=1), unreadable)


def log_imus(
    log: Log,
    topics: Sequence[Topic],
    find_extrinsics: Callable[[str], Floats | None],
    given: ImuCalibration | None = None,
) -> list[Imu]:
    """The inertial sensors of a log in the order of topics; gyro and accel topics are joined."""
    single = {topic.name: LogImu(log, topic, find_extrinsics, given) for topic in topics}
    partners = {name: _GYRO.sub("accel", name) for name in single if _GYRO.search(name)}
    partners = {gyro: accel for gyro, accel in partners.items() if accel in single}
    return [
        PairedImu(imu, single[partners[name]]) if name in partners else imu
        for name, imu in single.items()
        if name not in partners.values()
    ]
