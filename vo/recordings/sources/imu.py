"""Inertial measurements of a recording, read on demand."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import astuple
from functools import cached_property
from typing import Protocol

import numpy as np

from vo.base.frozen import frozen
from vo.base.noise_classes import NOISE_CLASSES
from vo.base.types import Floats, ImuNoise, Ints
from vo.recordings.formats.calibration import Calibration, ImuCalibration

_MIN_NOISE = (1e-6, 1e-8, 1e-5, 1e-7)
_log = logging.getLogger(__name__)


@frozen(eq=False)
class ImuSamples:
    """Samples of an inertial sensor, in its own frame.

    Attributes:
        stamps_ns: (N,) int64, increasing.
        gyro: (N, 3) rad/s.
        accel: (N, 3) m/s², specific force: +9.81 upwards at rest.
        unreadable: number of samples skipped because they are damaged or not finite.
        repeated: number of samples skipped because of a repeated stamp.

    Both counts are 0 for a part of a file, because skipped samples have no usable stamp.
    """

    stamps_ns: Ints
    gyro: Floats
    accel: Floats
    unreadable: int = 0
    repeated: int = 0

    def __len__(self) -> int:
        return len(self.stamps_ns)


class NamedNoise(Protocol):
    """An inertial sensor by its noise."""

    @property
    def name(self) -> str:
        """Topic, file or folder of the sensor."""
        ...

    @property
    def noise(self) -> ImuNoise | None:
        """Noise densities of the sensor; None if unknown (see `usable_noise`)."""
        ...


class Imu(NamedNoise, Protocol):
    """An inertial sensor of a recording."""

    @property
    def stamps_ns(self) -> Ints:
        """(N,) times of all samples, increasing.

        Raises:
            SourceError: the samples cannot be read.
        """
        ...

    @property
    def cam0_from_imu(self) -> Floats | None:
        """Pose of the sensor relative to cam0, (4, 4); None if unknown."""
        ...

    @property
    def time_offset_s(self) -> float:
        """What to add to the stamp of an image to get the same moment on the sensor's clock."""
        ...

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """Read the samples of a time range, both ends included; by default all.

        Raises:
            SourceError: the samples cannot be read.
        """
        ...

    def read_some(self, max_samples: int) -> ImuSamples:
        """Read parts spread over the recording, or everything if that is no slower.

        Raises:
            SourceError: the samples cannot be read.
        """
        ...


class FileImu:
    """An `Imu` whose files are read as a whole, on first use."""

    def __init__(
        self,
        name: str,
        load: Callable[[], ImuSamples],
        find_extrinsics: Callable[[], Floats | None],
        find_noise: Callable[[], ImuNoise | None] = lambda: None,
        time_offset_s: float = 0.0,
    ) -> None:
        """Store the functions that read the sensor.

        `find_extrinsics`: finds cam0_from_imu.
        """
        self.name = name
        self.time_offset_s = time_offset_s
        self._load = load
        self._find_extrinsics = find_extrinsics
        self._find_noise = find_noise

    @cached_property
    def _all(self) -> ImuSamples:
        return self._load()

    @property
    def stamps_ns(self) -> Ints:
        """See `Imu.stamps_ns`."""
        return self._all.stamps_ns

    @cached_property
    def cam0_from_imu(self) -> Floats | None:
        """See `Imu.cam0_from_imu`."""
        return self._find_extrinsics()

    @cached_property
    def noise(self) -> ImuNoise | None:
        """See `Imu.noise`."""
        return self._find_noise()

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """See `Imu.read`."""
        samples = self._all
        rows = time_slice(samples.stamps_ns, first_ns, last_ns)
        return ImuSamples(samples.stamps_ns[rows], samples.gyro[rows], samples.accel[rows])

    def read_some(self, max_samples: int) -> ImuSamples:
        """See `Imu.read_some`."""
        return self._all


def imu_of(calibration: Calibration | None) -> ImuCalibration:
    """What the calibration file contains about the inertial sensor."""
    return ImuCalibration() if calibration is None else calibration.imu


def usable_noise(imu: NamedNoise) -> ImuNoise:
    """The noise of a sensor; if it is unknown, that of a consumer sensor, with a warning.

    Values of 0, as of a simulated sensor, are replaced by tiny ones, so that covariances are
    regular.
    """
    noise = imu.noise
    if noise is None:
        noise = NOISE_CLASSES["consumer"]
        _log.warning(
            "%s: noise unknown, that of a consumer sensor is assumed; give it in the calibration "
            "(docs/imu-data.md)",
            imu.name,
        )
    pairs = zip(astuple(noise), _MIN_NOISE, strict=True)
    return ImuNoise(*(max(value, least) for value, least in pairs))


def time_slice(stamps_ns: Ints, first_ns: int | None, last_ns: int | None) -> slice:
    """The rows of a time range, both ends included."""
    start, end = 0, len(stamps_ns)
    if first_ns is not None:
        start = int(np.searchsorted(stamps_ns, first_ns))
    if last_ns is not None:
        end = int(np.searchsorted(stamps_ns, last_ns, side="right"))
    return slice(start, end)


def joined_samples(gyro: ImuSamples, accel: ImuSamples) -> ImuSamples:
    """Samples of two sensors in one: accelerations at the stamps of the gyroscope."""
    stamps, unreadable = gyro.stamps_ns, gyro.unreadable + accel.unreadable
    if len(accel) == 0:
        return ImuSamples(stamps[:0], gyro.gyro[:0], gyro.accel[:0], unreadable)
    # Relative to the first stamp, because a float64 cannot represent nanoseconds since 1970.
    times, accel_times = stamps - stamps[:1], accel.stamps_ns - stamps[:1]
    columns = [np.interp(times, accel_times, axis) for axis in accel.accel.T]
    return ImuSamples(stamps, gyro.gyro, np.stack(columns, axis=1), unreadable)


def make_samples(
    stamps_ns: list[int], values: list[list[float]] | Floats, unreadable: int
) -> ImuSamples:
    """Sort samples by stamp, and drop those that are not finite or repeat a stamp.

    `values`: N rows of gyro x, y, z and accel x, y, z.
    """
    stamps = np.array(stamps_ns, dtype=np.int64)
    rows = np.array(values, dtype=np.float64).reshape(-1, 6)
    finite = np.isfinite(rows).all(axis=1)
    kept, first = np.unique(stamps[finite], return_index=True)
    rows = rows[finite][first]
    return ImuSamples(
        stamps_ns=kept,
        gyro=rows[:, :3],
        accel=rows[:, 3:],
        unreadable=unreadable + int((~finite).sum()),
        repeated=int(finite.sum()) - len(kept),
    )
