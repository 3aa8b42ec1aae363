"""Warnings about the calibration of an inertial sensor, and comments in its file."""

from __future__ import annotations

import numpy as np

from vo.tools.calibrating.imu_camera import ImuOnCamera

_MAX_ROTATION_DEG, _MAX_TRANSLATION_M, _MAX_OFFSET_S = 0.1, 0.003, 0.5e-3
_MAX_MISFIT = 3.0
_MIN_SECONDS = 10.0
_MAX_CORNER_PX = 0.7


def warnings_of(found: ImuOnCamera) -> list[str]:
    """What the user should know about the result, and do."""
    lines = []
    if found.seconds < _MIN_SECONDS:
        lines.append(f"only {found.seconds:.0f} s are used; 30 to 60 s are better")
    if float(np.max(found.rotation_sd_deg)) > _MAX_ROTATION_DEG:
        lines.append(
            f"the rotation is known to {np.max(found.rotation_sd_deg):.2g} degrees only; turn the "
            "camera more, about all three axes"
        )
    if float(np.max(found.translation_sd_m)) > _MAX_TRANSLATION_M:
        lines.append(
            f"the position is known to {1e3 * np.max(found.translation_sd_m):.2g} mm only; turn "
            "the camera faster, back and forth, so that rotations accelerate"
        )
    if found.time_offset_sd_s > _MAX_OFFSET_S:
        lines.append(f"the time offset is known to {1e3 * found.time_offset_sd_s:.2g} ms only")
    if found.misfit > _MAX_MISFIT:
        lines.append(
            f"samples and images fit {found.misfit:.1f} times worse than their noise: rolling "
            "shutter, motion blur, a wrong size of the squares, stamps of arrival, or more noise "
            "than given"
        )
    if found.corner_rms_px > _MAX_CORNER_PX:
        lines.append(
            f"corners are off by {found.corner_rms_px:.2f} px: check the calibration of the "
            "camera, use shorter exposures"
        )
    return lines


def comments(found: ImuOnCamera) -> list[str]:
    """Comments for the calibration file."""
    return [
        f"vo calibrate --imu: {found.views} views in {found.seconds:.1f} s, corners "
        f"{found.corner_rms_px:.3f} px RMS, misfit {found.misfit:.2f}",
        f"standard deviations: rotation {np.max(found.rotation_sd_deg):.4f} degrees, position "
        f"{1e3 * np.max(found.translation_sd_m):.2f} mm, time offset "
        f"{1e3 * found.time_offset_sd_s:.3f} ms",
    ]
