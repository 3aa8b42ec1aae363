"""Inertial measurements that a recording brings along; none is read before it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from vo.formats.calibration import Calibration
from vo.geometry.transforms import inverse
from vo.types import Floats, ImuNoise, Ints

_BODY_IS_IMU = ("Kalibr", "Basalt", "ORB-SLAM3")
"""Kinds of calibration file that say where cameras are beside the inertial sensor."""


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """What an inertial sensor measured, in its own frame.

    Attributes:
        stamps_ns: (N,) int64, increasing.
        gyro: (N, 3) rad/s.
        accel: (N, 3) m/s², specific force: 9.81 upwards at rest.
        unreadable: samples that were left out as damaged or not finite.
        repeated: samples that were left out as their stamp was there before.

    Those of a table that was not read as a whole belong to no time and are not counted.
    """

    stamps_ns: Ints
    gyro: Floats
    accel: Floats
    unreadable: int = 0
    repeated: int = 0

    def __len__(self) -> int:
        return len(self.stamps_ns)


class Imu(Protocol):
    """An inertial sensor of a recording."""

    @property
    def name(self) -> str:
        """Its topic, table or folder."""
        ...

    @property
    def stamps_ns(self) -> Ints:
        """(N,) the times of all samples, increasing.

        Raises:
            SourceError: they cannot be read.
        """
        ...

    @property
    def cam0_from_imu(self) -> Floats | None:
        """Where it is, (4, 4); None where the recording does not say."""
        ...

    @property
    def noise(self) -> ImuNoise | None:
        """Its noise; None where the recording does not say."""
        ...

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """The samples from one time to another, both included; by default all.

        Raises:
            SourceError: they cannot be read.
        """
        ...

    def read_some(self, most: int) -> ImuSamples:
        """Stretches spread over the recording, or all where that costs no more; raises as `read`.

        Args:
            most: how many samples that may be.
        """
        ...


class TableImu:
    """An `Imu` in files that are read as a whole."""

    def __init__(
        self,
        name: str,
        load: Callable[[], ImuSamples],
        place: Callable[[], Floats | None],
        noise: Callable[[], ImuNoise | None] = lambda: None,
    ) -> None:
        """Take what will be read.

        Args:
            name: of the table or folder.
            load: reads all samples; may raise SourceError.
            place: finds out cam0_from_imu.
            noise: finds out the noise.
        """
        self.name = name
        self._load = load
        self._place = place
        self._noise = noise

    @cached_property
    def _all(self) -> ImuSamples:
        return self._load()

    @property
    def stamps_ns(self) -> Ints:
        """As `Imu.stamps_ns`."""
        return self._all.stamps_ns

    @cached_property
    def cam0_from_imu(self) -> Floats | None:
        """As `Imu.cam0_from_imu`."""
        return self._place()

    @cached_property
    def noise(self) -> ImuNoise | None:
        """As `Imu.noise`."""
        return self._noise()

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """As `Imu.read`."""
        found = self._all
        rows = rows_between(found.stamps_ns, first_ns, last_ns)
        return ImuSamples(found.stamps_ns[rows], found.gyro[rows], found.accel[rows])

    def read_some(self, most: int) -> ImuSamples:
        """As `Imu.read_some`."""
        return self._all


def cam0_from_imu_in(calibration: Calibration | None) -> Floats | None:
    """Where the inertial sensor is, as far as a calibration file says it."""
    if calibration is None or calibration.kind not in _BODY_IS_IMU:
        return None
    body_from_cam0 = calibration.body_from_cam0
    return None if body_from_cam0 is None else inverse(body_from_cam0)


def rows_between(stamps_ns: Ints, first_ns: int | None, last_ns: int | None) -> slice:
    """The rows from one time to another, both included."""
    start, end = 0, len(stamps_ns)
    if first_ns is not None:
        start = int(np.searchsorted(stamps_ns, first_ns))
    if last_ns is not None:
        end = int(np.searchsorted(stamps_ns, last_ns, side="right"))
    return slice(start, end)


def make_samples(stamps_ns: list[int], values: list[list[float]], unreadable: int) -> ImuSamples:
    """Samples in the order of their stamps, without those that are not finite or repeat a stamp.

    Args:
        stamps_ns: N of them.
        values: of each, gyro x, y, z and accel x, y, z.
        unreadable: how many more there should be.
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
