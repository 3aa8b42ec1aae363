"""Noise and time offset of an inertial sensor from values of a calibration file, with checks."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from vo.base.errors import CalibrationError
from vo.base.types import ImuNoise
from vo.recordings.formats.calibration.numbers import make_number

_HIGHEST = (1.0, 1.0, 100.0, 100.0)
"""Noise above these is in another unit, or a text has been misread."""
_UNITS = ("rad/s/√Hz", "rad/s²/√Hz", "m/s²/√Hz", "m/s³/√Hz")
_MAX_OFFSET_S = 1.0
_log = logging.getLogger(__name__)


def make_noise(
    where: str, values: Mapping[str, Any], names: tuple[str, str, str, str]
) -> ImuNoise | None:
    """The noise of a sensor; None if the file has none of its values.

    `names`: keys of the white noise of the gyroscope, its random walk, and the same of the
    accelerometer.
    """
    if not any(name in values for name in names):
        return None
    missing = [name for name in names if name not in values]
    if missing:
        raise CalibrationError(
            f"{where}: {missing[0]} is missing; noise is given by {', '.join(names)}"
        )
    numbers = [make_number(f"{where}: {name}", values[name]) for name in names]
    for name, number, highest, unit in zip(names, numbers, _HIGHEST, _UNITS, strict=True):
        if not 0.0 <= number <= highest:
            raise CalibrationError(
                f"{where}: {name} is {number:g}; it must be from 0 to {highest:g} {unit}"
            )
    return ImuNoise(*numbers)


def make_time_offset(where: str, value: Any) -> float:
    """A time offset in seconds; 0 if it is missing. A large one causes a warning."""
    if value is None:
        return 0.0
    offset_s = make_number(where, value)
    if abs(offset_s) > _MAX_OFFSET_S:
        _log.warning("%s is %g s between camera and IMU; it must be in seconds", where, offset_s)
    return offset_s
