"""Error of the right camera of a pair from its vertical disparity, and when to correct it."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import (
    FittedVerticalDisparity,
    VerticalDisparity,
    sigmas_px,
)
from vo.base.records.calibration_errors import RightCameraError
from vo.base.types import Floats

_SIGNIFICANT = 2.0  # standard deviations
# Smaller errors do no harm, and without correction images that are used as recorded stay so.
_MIN_PX, _MIN_WITH_SKEW_PX = 0.5, 2.0
_LARGE_PX = 1.5  # errors that cannot wait for other pairs: few points match along rows
_MAX_ROW_RATIO = 0.05  # of the image height; a slightly wrong rectification explains no more


def is_worth_correcting(fitted: FittedVerticalDisparity, rig: RectifiedRig) -> bool:
    """Whether errors at the corners of the image are large and significant.

    Without the skew, which has no effect on disparities, they must be so by themselves.
    """
    x, y = _corners(rig)
    error, without_skew = fitted.errors, fitted.errors._replace(skew_px=0.0)
    sigma, sigma_without_skew, sigma_horizontal = sigmas_px(fitted.covariance, x, y)
    is_worth = [
        np.abs(errors) > np.maximum(_SIGNIFICANT * sigmas, min_px)
        for errors, sigmas, min_px in (
            (error.vertical_px(x, y), sigma, _MIN_WITH_SKEW_PX),
            (without_skew.vertical_px(x, y), sigma_without_skew, _MIN_PX),
            (without_skew.horizontal_px(x, y), sigma_horizontal, _MIN_PX),
        )
    ]
    return bool(np.any(is_worth))


def is_large(error: VerticalDisparity, rig: RectifiedRig) -> bool:
    """Whether errors at the corners of the image are too large to wait for further pairs."""
    x, y = _corners(rig)
    no_skew = np.abs(error._replace(skew_px=0.0).vertical_px(x, y))
    vertical = np.abs(error.vertical_px(x, y))
    return bool(((no_skew > _LARGE_PX) | (vertical > _MIN_WITH_SKEW_PX)).any())


def is_plausible(error: VerticalDisparity, rig: RectifiedRig) -> bool:
    """Whether a slightly wrong rectification explains vertical disparities as large as these."""
    return max_row_error(error, rig) <= _MAX_ROW_RATIO * rig.height


def max_row_error(error: VerticalDisparity, rig: RectifiedRig) -> float:
    """Largest vertical disparity at the corners of the image, in pixels."""
    return float(np.abs(error.vertical_px(*_corners(rig))).max())


def largest_change(one: VerticalDisparity, other: VerticalDisparity, rig: RectifiedRig) -> float:
    """Maximum difference of two corrections at the corners of the image, in pixels."""
    x, y = _corners(rig)
    vertical = one.vertical_px(x, y) - other.vertical_px(x, y)
    horizontal = one.horizontal_px(x, y) - other.horizontal_px(x, y)
    return float(max(np.abs(vertical).max(), np.abs(horizontal).max()))


def right_camera_error(corrected: VerticalDisparity, rig: RectifiedRig) -> RightCameraError | None:
    """Corrected errors as angles and zoom of the right camera; None if nothing is corrected."""
    yaw_px = -rig.disparity_offset_px if rig.offset_is_yaw else 0.0
    if corrected == VerticalDisparity() and yaw_px == 0.0:
        return None
    pitch, yaw, roll = np.rad2deg(
        np.array([corrected.pitch_px, yaw_px, corrected.roll_px]) / rig.fx
    )
    return RightCameraError(
        *(float(pitch), float(yaw), float(roll)),
        zoom_percent=100.0 * corrected.zoom_px / rig.fx,
        rows_px=max_row_error(corrected, rig),
        bend_px=corrected.bend_px,
        skew_px=corrected.skew_px,
    )


def _corners(rig: RectifiedRig) -> tuple[Floats, Floats]:
    """Normalised x and y of the image's corners."""
    u, v = np.array([(u, v) for u in (0, rig.width - 1) for v in (0, rig.height - 1)]).T
    return (u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy
