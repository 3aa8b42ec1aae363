"""The inertial measurements of a recording on their way to another layout."""

from __future__ import annotations

import logging

import numpy as np

from data_synth.records import BODY, Imu
from vo.errors import VoError
from vo.geometry.transforms import inverse
from vo.sources.source import Source
from vo.types import Floats, Ints

_log = logging.getLogger(__name__)

_WITH_ROOM = ("euroc", "mcap", "mcap-ros2")
_SENSOR = "imu0"


def imu_around(source: Source, stamps_ns: Ints, format: str) -> tuple[Imu | None, Floats]:
    """What the first inertial sensor measured, from one sample before the frames to one after.

    Args:
        source: the recording.
        stamps_ns: of the frames.
        format: a key of the writers' `FORMATS`.

    Returns:
        The measurements, None where there are none or the layout has no room for them; and
        body_from_cam0: the body is the sensor, or cam0 where nobody knows where the sensor is.
    """
    if not source.imus:
        return None, np.eye(4)
    sensor = source.imus[0]
    if format not in _WITH_ROOM:
        _log.warning("%s left out: format %s has no room for it", sensor.name, format)
        return None, np.eye(4)
    try:
        all_ns = sensor.stamps_ns
        first = int(np.searchsorted(all_ns, stamps_ns[0])) - 1
        last = int(np.searchsorted(all_ns, stamps_ns[-1], side="right"))
        kept = all_ns[max(0, first) : last + 1]
        samples = sensor.read(int(kept[0]), int(kept[-1])) if len(kept) else None
        place = sensor.cam0_from_imu
    except VoError as error:
        _log.warning("inertial measurements left out: %s", error)
        return None, np.eye(4)
    if samples is None or len(samples) < 2:
        _log.warning("%s left out: it measured nothing at the time of the frames", sensor.name)
        return None, np.eye(4)
    if place is None:
        _log.warning("%s: nothing says where it is beside the camera", sensor.name)
    imu = Imu(
        stamps_ns=samples.stamps_ns,
        gyro=samples.gyro,
        accel=samples.accel,
        rate_hz=1e9 / float(np.median(np.diff(samples.stamps_ns))),
        noise=sensor.noise,
        frame=_SENSOR if place is None else BODY,
    )
    return imu, np.eye(4) if place is None else inverse(place)
