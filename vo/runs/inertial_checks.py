"""Whether an inertial sensor can be used with the images of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.geometry.quantiles import median, percentiles
from vo.base.records.inertial_use import InertialUse
from vo.base.types import Ints

if TYPE_CHECKING:
    from vo.engine.inertial.samples import InertialSensor, Samples

_MIN_RATE_HZ = 50.0
_MIN_COVERED = 0.95  # of the images
_GAP = 2.5  # shortest interval that counts as a gap, in median intervals
_MAX_GAP_RATIO = 0.05  # of all intervals
_PARTS, _PART_NS = 5, 4_000_000_000  # of the recording whose values are checked
_IN_G = (0.8, 1.2)
_USUAL_ACCEL_M_S2 = (7.0, 20.0)  # mean; only racing drones are far above 9.81
_MAX_MEDIAN_RATE_RAD_S = 4.0  # faster than any camera turns most of the time
_MAX_RATE_RAD_S = 35.0  # 2000 degrees per second, the range of most sensors


class Unusable(NamedTuple):
    """Why a sensor is not used; no error if it was not meant to be."""

    reason: str
    is_error: bool = True


def contradiction_faults(use: InertialUse | None, *, is_handled: bool) -> list[Fault]:
    """The fault of a sensor that contradicts the images, if it does.

    Args:
        use: the sensor, None without one.
        is_handled: whether the path was made without it.
    """
    if use is None or not use.is_contradiction:
        return []
    return [Fault(FaultKind.INERTIAL_CONTRADICTION, is_handled)]


def why_unusable(sensor: InertialSensor, image_stamps_ns: Ints) -> Unusable | None:
    """Check the pose and the stamps of a sensor, and the values of parts of its samples.

    Returns:
        None if it can be used.

    Raises:
        SourceError: the samples cannot be read.
    """
    if sensor.cam0_from_imu is None:
        return Unusable("its pose relative to the camera is unknown", is_error=False)
    stamps = sensor.stamps_ns
    if len(stamps) < 2:
        return Unusable("it has no samples")
    steps = np.diff(stamps)
    usual_ns = median(steps)
    rate = 1e9 / usual_ns
    if rate < _MIN_RATE_HZ:
        return Unusable(f"{rate:.3g} samples per second are too few", is_error=False)
    covered = (image_stamps_ns >= stamps[0]) & (image_stamps_ns <= stamps[-1])
    if covered.mean() < _MIN_COVERED:
        share = 100 * covered.mean()
        return Unusable(f"it covers {share:.0f} % of the images in time: is its clock another one?")
    gaps = float((steps > _GAP * usual_ns).mean())
    if gaps > _MAX_GAP_RATIO:
        return Unusable(f"{100 * gaps:.0f} % of its samples come after a gap")
    return _wrong_values(_parts(sensor, image_stamps_ns))


def _parts(sensor: InertialSensor, image_stamps_ns: Ints) -> list[Samples]:
    first, last = int(image_stamps_ns[0]), int(image_stamps_ns[-1])
    begins = np.linspace(first, max(first, last - _PART_NS), _PARTS).astype(np.int64)
    parts = [sensor.read(begin, begin + _PART_NS) for begin in begins.tolist()]
    return [part for part in parts if len(part.stamps_ns)]


def _wrong_values(parts: list[Samples]) -> Unusable | None:
    if not parts:
        return Unusable("it has no samples during the images")
    accel = np.concatenate([part.accel for part in parts])
    gyro = np.concatenate([part.gyro for part in parts])
    if not (np.ptp(accel, axis=0).any() and np.ptp(gyro, axis=0).any()):
        return Unusable("its values never change")
    mean = float(np.linalg.norm(accel, axis=1).mean())
    rate = np.linalg.norm(gyro, axis=1)
    if _IN_G[0] <= mean <= _IN_G[1]:
        return Unusable(f"the mean acceleration is {mean:.3g}, probably in g instead of m/s²")
    if not _USUAL_ACCEL_M_S2[0] <= mean <= _USUAL_ACCEL_M_S2[1]:
        return Unusable(f"the mean acceleration is {mean:.3g} m/s² instead of about 9.81")
    high = percentiles(rate, [99.0])[0]
    if median(rate) > _MAX_MEDIAN_RATE_RAD_S or high > _MAX_RATE_RAD_S:
        return Unusable(
            f"1 % of the angular rates are above {high:.3g} rad/s: probably degrees per second"
        )
    return None
