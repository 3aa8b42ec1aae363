"""Comparison of an inertial sensor with the images: time offset, axes and pose, units, clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from vo.base.errors import VoError
from vo.base.geometry.transforms import rotation_angle
from vo.base.types import Bytes, Camera, Floats, Ints
from vo.engine.geometry.gyro_alignment import GyroAlignment, Rotations, align_gyro
from vo.recordings.sources.imu import Imu, ImuSamples
from vo.tools.inspection.image_rotation import measure_rotations
from vo.tools.inspection.reports import Finding, ImuMotionReport, ImuReport

_MIN_COMPARED = 20
_MIN_RATE_RAD_S = 0.05
_MAX_OFFSET_MS, _MAX_OFFSET_SD = 4.0, 6.0  # intervals overlap, so that the latter is too small
_MAX_ERROR_DEG = 5.0
_MAX_SD_DEG = 2.0
_DEGREES = (30.0, 100.0)  # ratio of rates in degrees to those in radians, with tolerance
_AXES = "xyz"


def compare_motion(
    imu: Imu, read: Callable[[int], Bytes | None], stamps_ns: Ints, camera: Camera
) -> ImuMotionReport | None:
    """Compare the rotation of images with the gyroscope; None if there is too little of it.

    `read`: reads an image of cam0 by number, None if it is unreadable. `stamps_ns`: (N,) stamps of
    the images. `camera`: cam0.
    """
    try:
        samples = imu.read()
        pose = imu.cam0_from_imu
    except VoError:
        return None  # reported already
    rotations = measure_rotations(read, stamps_ns, camera, samples.stamps_ns, samples.gyro)
    if len(rotations.rotvec) < _MIN_COMPARED:
        return None
    seconds = (rotations.last_ns - rotations.first_ns)[:, None] / 1e9
    rates = rotations.rotvec / seconds
    spread = float(np.median(np.linalg.norm(rates - np.median(rates, axis=0), axis=1)))
    found = align_gyro(rotations, samples.stamps_ns, samples.gyro)
    if found is None and spread < _MIN_RATE_RAD_S:
        return None
    given = None if pose is None else pose[:3, :3]
    return ImuMotionReport(
        compared=len(rotations.rotvec),
        fits=found is not None,
        time_offset_ms=None if found is None else 1e3 * found.time_offset_s,
        time_offset_sd_ms=None if found is None else 1e3 * found.time_offset_sd_s,
        given_offset_ms=1e3 * imu.time_offset_s,
        cam0_from_imu_rotation=None if found is None else found.cam_from_imu.tolist(),
        rotation_error_deg=None if given is None else _error_deg(found, given),
        inverse_error_deg=None if given is None else _error_deg(found, given.T),
        is_mirrored=found is not None and found.is_mirrored,
        rate_ratio=_ratio(samples, rotations, spread),
    )


def _error_deg(found: GyroAlignment | None, given: Floats) -> float | None:
    if found is None or found.is_mirrored:
        return None
    if found.rotation_sd_rad < np.radians(_MAX_SD_DEG):
        return float(np.degrees(rotation_angle(found.cam_from_imu @ given.T)))
    cosine = float((found.cam_from_imu @ found.main_axis) @ (given @ found.main_axis))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _ratio(samples: ImuSamples, rotations: Rotations, spread: float) -> float:
    """Rate of the gyroscope in the middle of the intervals, relative to that of the camera."""
    middle = (rotations.first_ns + rotations.last_ns) // 2 - samples.stamps_ns[0]
    times = samples.stamps_ns - samples.stamps_ns[0]
    rates = np.stack([np.interp(middle, times, axis) for axis in samples.gyro.T], axis=1)
    change = np.linalg.norm(rates - np.median(rates, axis=0), axis=1)
    return float(np.median(change)) / max(spread, 1e-9)


def motion_findings(imu: ImuReport) -> Iterator[Finding]:
    """Findings about a sensor compared with the images."""
    motion = imu.motion
    if motion is None:
        return
    if not motion.fits:
        yield _misfit(imu, motion)
        return
    assert motion.time_offset_ms is not None and motion.time_offset_sd_ms is not None
    off = motion.time_offset_ms - motion.given_offset_ms
    if abs(off) > max(_MAX_OFFSET_MS, _MAX_OFFSET_SD * motion.time_offset_sd_ms):
        instead = f" instead of {motion.given_offset_ms:.1f}" if motion.given_offset_ms else ""
        yield Finding(
            "warning",
            f"{imu.name}: {motion.time_offset_ms:+.1f} ms must be added to stamps of images to get "
            f"its clock{instead} (standard deviation {motion.time_offset_sd_ms:.1f} ms)",
            f"give imu: {{time_offset_s: {1e-3 * motion.time_offset_ms:.4f}}} in the calibration "
            "(docs/imu-data.md)",
        )
    yield from _pose_findings(imu, motion)


def _misfit(imu: ImuReport, motion: ImuMotionReport) -> Finding:
    if _DEGREES[0] < motion.rate_ratio < _DEGREES[1]:
        return Finding(
            "warning",
            f"{imu.name}: angular rates are {motion.rate_ratio:.0f} times those of the images: "
            "probably in degrees per second",
            "it must be in rad/s: multiply by 0.0174533",
        )
    return Finding(
        "warning",
        f"{imu.name}: angular rates do not match the rotation of the images at any time offset up "
        f"to 0.3 s ({motion.compared} pairs compared)",
        "check that both are of one recording and one clock, and the calibration of the camera",
    )


def _pose_findings(imu: ImuReport, motion: ImuMotionReport) -> Iterator[Finding]:
    if motion.is_mirrored:
        yield Finding(
            "warning",
            f"{imu.name}: the axes of the gyroscope form a left-handed frame: one axis, or all, "
            f"have the wrong sign (seen from the camera: {_axes_text(motion)})",
            "check the order and the signs of its axes in the driver",
        )
        return
    error, inverse = motion.rotation_error_deg, motion.inverse_error_deg
    if error is None or error <= _MAX_ERROR_DEG:
        return
    reason = f"by the motion, {_axes_text(motion)}"
    if inverse is not None and inverse <= _MAX_ERROR_DEG:
        reason = "its inverse fits: it is probably given in the other direction"
    yield Finding(
        "warning",
        f"{imu.name}: its orientation on the camera is off by {error:.0f} degrees; {reason}",
        "check cam0_from_imu (T_cam_imu) in the calibration, and the axes of the sensor",
    )


def _axes_text(motion: ImuMotionReport) -> str:
    """The axis of the sensor that is closest to each axis of the camera."""
    assert motion.cam0_from_imu_rotation is not None
    texts = []
    for name, row in zip(("right", "down", "ahead"), motion.cam0_from_imu_rotation, strict=True):
        axis = int(np.argmax(np.abs(row)))
        texts.append(f"{name} is {'+' if row[axis] > 0 else '-'}{_AXES[axis]}")
    return ", ".join(texts)
