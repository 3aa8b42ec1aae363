"""Checks of inertial sensors: rates, gaps and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from vo.errors import VoError
from vo.inspection.opening import LoggedWarning, collected_warnings
from vo.inspection.records import Finding, ImuReport
from vo.sources.imu import Imu
from vo.types import Ints

_GAP = 2.5
"""Shortest interval that counts as a gap, in median intervals."""

_MAX_SAMPLES = 10_000
"""Largest number of samples whose values are checked by default."""

_IN_G = (0.8, 1.2)
_USUAL_ACCEL_M_S2 = (7.0, 20.0)  # mean; only racing drones are far above 9.81
_MIN_GRAVITY_M_S2 = 5.0
_MAX_MEDIAN_RATE_RAD_S = 4.0  # faster than any camera turns most of the time
_MAX_RATE_RAD_S = 35.0  # 2000 degrees per second, the range of most sensors
_MIN_COVERED = 0.95


def check_imus(
    imus: Sequence[Imu], image_stamps_ns: Ints, everything: bool
) -> tuple[tuple[ImuReport, ...], list[str]]:
    """Check the stamps of all samples, and the values of some.

    Args:
        imus: the sensors.
        image_stamps_ns: (N,) stamps of the left images.
        everything: check all values.

    Returns:
        A report on each sensor, and the warnings logged while they were read.
    """
    reports = []
    with collected_warnings() as warnings:
        for imu in imus:
            try:
                reports.append(_check(imu, image_stamps_ns, everything))
            except VoError as error:
                warnings.append(LoggedWarning(f"{imu.name}: {error}"))
    return tuple(reports), list(dict.fromkeys(warning.text for warning in warnings))


def _check(imu: Imu, image_stamps_ns: Ints, everything: bool) -> ImuReport:
    stamps = imu.stamps_ns
    steps = np.diff(stamps)
    median = float(np.median(steps)) if len(steps) else 0.0
    gaps = steps[steps > _GAP * median]
    samples = imu.read() if everything else imu.read_some(_MAX_SAMPLES)
    accel, gyro = np.linalg.norm(samples.accel, axis=1), np.linalg.norm(samples.gyro, axis=1)
    place = imu.cam0_from_imu
    covered = np.zeros(len(image_stamps_ns))
    if len(stamps):
        covered[(image_stamps_ns >= stamps[0]) & (image_stamps_ns <= stamps[-1])] = 1.0
    return ImuReport(
        name=imu.name,
        count=len(stamps),
        first_ns=int(stamps[0]) if len(stamps) else 0,
        span_s=1e-9 * float(stamps[-1] - stamps[0]) if len(stamps) else 0.0,
        rate_hz=1e9 / median if median else 0.0,
        gaps=len(gaps),
        longest_gap_s=1e-9 * float(gaps.max()) if len(gaps) else 0.0,
        looked_at=len(accel),
        unreadable=samples.unreadable,
        accel_m_s2=float(accel.mean()) if len(accel) else 0.0,
        gyro_rad_s=float(np.median(gyro)) if len(gyro) else 0.0,
        gyro_high_rad_s=float(np.percentile(gyro, 99)) if len(gyro) else 0.0,
        covered=float(covered.mean()) if len(covered) else None,
        cam0_from_imu=None if place is None else place.tolist(),
    )


def imu_findings(imu: ImuReport) -> Iterator[Finding]:
    """Findings about an inertial sensor."""
    if imu.gaps:
        yield Finding(
            "warning",
            f"{imu.name}: gaps: {imu.gaps}, the longest {imu.longest_gap_s:.3g} s",
            "check for samples dropped by the recorder",
        )
    if imu.covered is not None and imu.covered < _MIN_COVERED:
        yield Finding(
            "warning",
            f"{imu.name}: covers {100 * imu.covered:.0f} % of the images in time",
            "check whether it uses the clock of the camera",
        )
    if imu.looked_at:
        yield from _value_findings(imu)


def _value_findings(imu: ImuReport) -> Iterator[Finding]:
    accel = imu.accel_m_s2
    if _IN_G[0] <= accel <= _IN_G[1]:
        yield Finding(
            "warning",
            f"{imu.name}: the mean acceleration is {accel:.3g}, probably in g",
            "it must be in m/s²: multiply by 9.80665",
        )
    elif accel < _MIN_GRAVITY_M_S2:
        yield Finding(
            "warning",
            f"{imu.name}: the mean acceleration is {accel:.3g} m/s²; with gravity it should be "
            "about 9.81",
            "record the raw acceleration, including gravity",
        )
    elif not _USUAL_ACCEL_M_S2[0] <= accel <= _USUAL_ACCEL_M_S2[1]:
        yield Finding(
            "warning",
            f"{imu.name}: the mean acceleration is {accel:.3g} m/s² instead of about 9.81",
            "check its unit and its calibration",
        )
    if imu.gyro_rad_s > _MAX_MEDIAN_RATE_RAD_S or imu.gyro_high_rad_s > _MAX_RATE_RAD_S:
        yield Finding(
            "warning",
            f"{imu.name}: the median angular rate is {imu.gyro_rad_s:.3g} rad/s, 1 % are above "
            f"{imu.gyro_high_rad_s:.3g}: probably in degrees per second",
            "it must be in rad/s: multiply by 0.0174533",
        )
