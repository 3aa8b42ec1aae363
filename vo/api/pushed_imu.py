"""The inertial sensor of a program, whose samples come one by one."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from vo.api.inputs import stamp_of
from vo.base.errors import CalibrationError, InputError
from vo.base.images.given_images import kind_of
from vo.base.records.inertial_use import InertialUse
from vo.base.types import Floats, ImuNoise, Ints, Rig
from vo.recordings.formats.calibration import Calibration, ImuCalibration
from vo.recordings.formats.warning_kinds import LoggedWarning
from vo.recordings.sources.imu import Imu, ImuSamples, time_slice
from vo.runs.inertial_checks import why_unusable

_NAME = "inertial sensor"
_CHECKED_NS = 4_000_000_000  # after which the samples until then are checked, once
_LATE = 0.02  # ratio of late samples from which on they are reported


class PushedImu:
    """Keeps the samples of a program; they may come from a thread of their own.

    Attributes:
        newest_frame_ns: time of the newest frame; samples until then come too late for it.
    """

    name = _NAME

    def __init__(self, given: ImuCalibration | Imu) -> None:
        self.cam0_from_imu: Floats | None = given.cam0_from_imu
        self.noise: ImuNoise | None = given.noise
        self.time_offset_s = given.time_offset_s
        self.newest_frame_ns = -1
        self._stamps, self._values = np.empty(1024, np.int64), np.empty((1024, 6))
        self._count = self._late = 0
        self._unusable = ""
        self._is_checked = False
        self._lock = threading.Lock()

    @classmethod
    def of(
        cls, given: bool | ImuCalibration | Imu | None, calibration: Calibration | Rig
    ) -> PushedImu | None:
        """The sensor of a program, None without one.

        Args:
            given: True for that of the calibration, or what describes it.
            calibration: of the cameras.

        Raises:
            CalibrationError: its pose on the camera is unknown.
        """
        if given is None or given is False:
            return None
        if given is True:
            given = calibration.imu if isinstance(calibration, Calibration) else ImuCalibration()
        assert not isinstance(given, bool)
        if given.cam0_from_imu is None:
            raise CalibrationError(
                "the pose of the inertial sensor on the camera is unknown; give it in the "
                "calibration file (docs/imu-data.md), or imu=vo.ImuCalibration(cam0_from_imu)"
            )
        return cls(given)

    @property
    def stamps_ns(self) -> Ints:
        """(N,) times of the samples so far."""
        return self._stamps[: self._count]

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> ImuSamples:
        """See `Imu.read`; nothing where the samples cannot be used."""
        with self._lock:
            count = 0 if self._unusable else self._count
            stamps, values = self._stamps[:count], self._values[:count]
        rows = time_slice(stamps, first_ns, last_ns)
        return ImuSamples(stamps[rows], values[rows, :3], values[rows, 3:])

    def add(self, stamp_ns: Any, gyro: Any, accel: Any) -> None:
        """Append a sample.

        Raises:
            InputError: it is no sample, comes out of order, or no sample can be used.
        """
        stamp = stamp_of(stamp_ns)
        values = np.concatenate([_vector(gyro, "gyro", "rad/s"), _vector(accel, "accel", "m/s²")])
        with self._lock:
            if self._count and stamp <= (last := int(self._stamps[self._count - 1])):
                raise InputError(
                    f"stamp_ns is {stamp}, the sample before had {last}; this one is left out: "
                    "give each sample once, in order"
                )
            if self._count == len(self._stamps):
                self._stamps = np.concatenate([self._stamps, np.empty_like(self._stamps)])
                self._values = np.concatenate([self._values, np.empty_like(self._values)])
            self._stamps[self._count], self._values[self._count] = stamp, values
            self._count += 1
            self._late += stamp <= self.newest_frame_ns + round(1e9 * self.time_offset_s)
        self._check()

    def warnings(self) -> tuple[LoggedWarning, ...]:
        """That many samples came too late, for the summary."""
        if self._late <= _LATE * self._count:
            return ()
        text = (
            f"{self._late} of {self._count} inertial samples came after a frame that is newer: "
            "give samples until the time of a frame before the frame"
        )
        return (LoggedWarning(text),)

    def use(self, found: InertialUse | None) -> InertialUse | None:
        """What became of the sensor, by what the odometry has found."""
        if self._unusable:
            return InertialUse(_NAME, self._unusable, is_error=True)
        return InertialUse(_NAME, "it gave no samples") if self._count == 0 else found

    def _check(self) -> None:
        stamps = self.stamps_ns
        if not self._is_checked and int(stamps[-1] - stamps[0]) >= _CHECKED_NS:
            self._is_checked = True
            found = why_unusable(self, stamps[:: max(1, len(stamps) // 100)])
            self._unusable = "" if found is None else found.reason
        if self._unusable:
            raise InputError(f"the inertial sensor is not used: {self._unusable}")


def _vector(value: Any, name: str, unit: str) -> Floats:
    try:
        vector = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {kind_of(value)}; give x, y and z in {unit}") from None
    if vector.shape != (3,):
        raise InputError(f"{name} has shape {vector.shape}; give x, y and z in {unit}")
    if not np.isfinite(vector).all():
        raise InputError(f"{name} is {vector.tolist()}; leave out samples that are not finite")
    return vector
