"""Conversion of inertial measurements."""

from __future__ import annotations

import logging

import numpy as np

from data_synth.records import BODY, Imu
from vo.base.errors import VoError
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, Ints
from vo.recordings.sources.imu import Imu as SourceImu
from vo.recordings.sources.imu import ImuSamples
from vo.recordings.sources.source import Recording

_log = logging.getLogger(__name__)

_FORMATS_WITH_IMU = ("euroc", "mcap", "mcap-ros2")
_SENSOR = "imu0"


def imu_around(source: Recording, stamps_ns: Ints, format: str) -> tuple[Imu | None, Floats]:
    """Measurements of the first inertial sensor, from one sample before the frames to one after.

    Args:
        source: the recording.
        stamps_ns: (N,) stamps of the frames.
        format: a key of the writers' `FORMATS`.

    Returns:
        The measurements, None if there are none or the format does not support them; and
        body_from_cam0, where the body is the sensor, or cam0 if the pose of the sensor is unknown.
    """
    if not source.imus:
        return None, np.eye(4)
    sensor = source.imus[0]
    if format not in _FORMATS_WITH_IMU:
        _log.warning("%s left out: format %s does not support it", sensor.name, format)
        return None, np.eye(4)
    try:
        samples, cam0_from_imu = _read_around(sensor, stamps_ns), sensor.cam0_from_imu
    except VoError as error:
        _log.warning("inertial measurements left out: %s", error)
        return None, np.eye(4)
    if samples is None or len(samples) < 2:
        _log.warning("%s left out: no measurements during the frames", sensor.name)
        return None, np.eye(4)
    if cam0_from_imu is None:
        _log.warning("%s: its pose relative to the camera is unknown", sensor.name)
    imu = Imu(
        stamps_ns=samples.stamps_ns,
        gyro=samples.gyro,
        accel=samples.accel,
        rate_hz=1e9 / float(np.median(np.diff(samples.stamps_ns))),
        noise=sensor.noise,
        frame=_SENSOR if cam0_from_imu is None else BODY,
    )
    return imu, np.eye(4) if cam0_from_imu is None else inverse(cam0_from_imu)


def _read_around(sensor: SourceImu, stamps_ns: Ints) -> ImuSamples | None:
    """Samples from one before the first stamp to one after the last; None without any."""
    all_ns = sensor.stamps_ns
    first = int(np.searchsorted(all_ns, stamps_ns[0])) - 1
    last = int(np.searchsorted(all_ns, stamps_ns[-1], side="right"))
    kept = all_ns[max(0, first) : last + 1]
    return sensor.read(int(kept[0]), int(kept[-1])) if len(kept) else None
