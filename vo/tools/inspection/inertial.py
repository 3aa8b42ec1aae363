"""Checks of inertial sensors: rates, gaps and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np

from vo.base.errors import VoError
from vo.base.types import Floats, Ints
from vo.recordings.formats.warning_kinds import LoggedWarning, collected_warnings
from vo.recordings.sources.imu import Imu, ImuSamples
from vo.tools.inspection.reports import Finding, ImuReport

_GAP = 2.5
"""Shortest interval that counts as a gap, in median intervals."""

_MAX_SAMPLES = 10_000
"""Largest number of samples whose values are checked by default."""

_IN_G = (0.8, 1.2)
_USUAL_ACCEL_M_S2 = (7.0, 20.0)  # mean; only racing drones are far above 9.81
_MIN_GRAVITY_M_S2 = 5.0
_MIN_RANGE_RAD_S, _MIN_RANGE_M_S2 = 2.0, 15.0  # smallest ranges: 125 degrees/s and 2 g
_MIN_HELD = 3  # pairs of consecutive samples at the same extreme value
_MAX_HELD = 0.5
_UPSIDE_DOWN = 0.7
_MIN_RATE_HZ = 50.0
_MAX_MEDIAN_RATE_RAD_S = 4.0  # faster than any camera turns most of the time
_MAX_RATE_RAD_S = 35.0  # 2000 degrees per second, the range of most sensors
_MIN_COVERED = 0.95


def check_imus(
    imus: Sequence[Imu], image_stamps_ns: Ints, everything: bool
) -> tuple[tuple[ImuReport, ...], list[str]]:
    """Check the stamps of all samples, and the values of some.

    `image_stamps_ns`: (N,) stamps of the left images.

    Returns a report on each sensor, and the warnings logged while they were read.
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
        accel_cam0=_accel_in_cam0(samples, place),
        gyro_saturated=saturated(samples.gyro, _MIN_RANGE_RAD_S),
        accel_saturated=saturated(samples.accel, _MIN_RANGE_M_S2),
        clock_ahead_s=_clock_ahead_s(stamps, image_stamps_ns),
        noise=None if imu.noise is None else asdict(imu.noise),
    )


def _accel_in_cam0(samples: ImuSamples, cam0_from_imu: Floats | None) -> list[float] | None:
    if cam0_from_imu is None or not len(samples):
        return None
    mean: list[float] = (cam0_from_imu[:3, :3] @ samples.accel.mean(axis=0)).tolist()
    return mean


def _clock_ahead_s(stamps_ns: Ints, image_stamps_ns: Ints) -> float | None:
    if not len(stamps_ns) or not len(image_stamps_ns):
        return None
    return 1e-9 * float(stamps_ns[0] - image_stamps_ns[0])


def saturated(values: Floats, least: float) -> float:
    """Fraction of samples (N, 3) that stay at the same largest value of an axis."""
    if not len(values):
        return 0.0
    clipped = np.zeros(len(values), dtype=bool)
    for axis in values.T:
        for signed in (axis, -axis):
            high = float(signed.max())
            at_end = signed >= high - 1e-6 * abs(high)
            held = at_end[1:] & at_end[:-1]
            # A sensor that does not move has one value too, but not for a small part of the time.
            if high >= least and held.sum() >= _MIN_HELD and at_end.mean() < _MAX_HELD:
                clipped |= at_end
    return float(clipped.mean())


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
            _clock_advice(imu),
        )
    if imu.count > 2 and imu.rate_hz < _MIN_RATE_HZ:
        yield Finding(
            "note",
            f"{imu.name}: {imu.rate_hz:.3g} samples per second",
            "100 or more follow the motion between images",
        )
    if imu.looked_at:
        yield from _value_findings(imu)


def _clock_advice(imu: ImuReport) -> str:
    advice = "check whether it uses the clock of the camera"
    if imu.covered == 0.0 and imu.clock_ahead_s is not None:
        side = "after" if imu.clock_ahead_s > 0 else "before"
        advice += f": its first sample is {abs(imu.clock_ahead_s):.3f} s {side} the first image"
    return advice


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
    elif imu.accel_cam0 is not None and imu.accel_cam0[1] > _UPSIDE_DOWN * accel:
        yield Finding(
            "note",
            f"{imu.name}: by its pose on the camera, up is down in the images",
            "fine if the camera hangs upside down; else accelerations have the wrong sign (+9.81 "
            "upwards at rest is right), or the pose is wrong",
        )
    for what, part in (
        ("angular rates", imu.gyro_saturated),
        ("accelerations", imu.accel_saturated),
    ):
        if part > 0.0:
            yield Finding(
                "warning",
                f"{imu.name}: {what} are clipped at the end of the range in "
                f"{100 * part:.2g} % of the samples",
                "choose a larger range of the sensor, or dampen its mount",
            )
    if imu.gyro_rad_s > _MAX_MEDIAN_RATE_RAD_S or imu.gyro_high_rad_s > _MAX_RATE_RAD_S:
        yield Finding(
            "warning",
            f"{imu.name}: the median angular rate is {imu.gyro_rad_s:.3g} rad/s, 1 % are above "
            f"{imu.gyro_high_rad_s:.3g}: probably in degrees per second",
            "it must be in rad/s: multiply by 0.0174533",
        )
