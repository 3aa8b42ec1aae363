"""What errors of rows say of the right camera of a pair, and whether they are worth correcting."""

from __future__ import annotations

import numpy as np

from vo.calibration_errors import RightCameraError
from vo.geometry.rectification import RectifiedRig
from vo.geometry.vertical_disparity_model import (
    FittedVerticalDisparity,
    VerticalDisparity,
    vertical_disparity_sigma,
)
from vo.types import Floats

_SURE = 2.0  # standard deviations
# Less is left alone: nothing is lost by it, and images that are used as recorded stay as they are.
_WORTH_PX, _WORTH_WITH_SKEW_PX = 0.5, 2.0


def is_worth_correcting(fitted: FittedVerticalDisparity, rig: RectifiedRig) -> bool:
    """Whether errors at the corners of the image are large and surely there."""
    x, y = _corners(rig)
    sure = np.abs(fitted.errors.vertical_px(x, y)) > _SURE * vertical_disparity_sigma(fitted, x, y)
    without_skew = fitted.errors._replace(skew_px=0.0)
    along = np.maximum(
        np.abs(without_skew.vertical_px(x, y)), np.abs(without_skew.horizontal_px(x, y))
    )
    across = np.abs(fitted.errors.vertical_px(x, y))
    return bool((sure & ((along > _WORTH_PX) | (across > _WORTH_WITH_SKEW_PX))).any())


def largest_change(one: VerticalDisparity, other: VerticalDisparity, rig: RectifiedRig) -> float:
    """By how many pixels two corrections differ at the corners of the image, at most."""
    x, y = _corners(rig)
    rows = one.vertical_px(x, y) - other.vertical_px(x, y)
    columns = one.horizontal_px(x, y) - other.horizontal_px(x, y)
    return float(max(np.abs(rows).max(), np.abs(columns).max()))


def right_camera_error(corrected: VerticalDisparity, rig: RectifiedRig) -> RightCameraError | None:
    """The same in words of the right camera, and how it looks sideways, if that is known."""
    yaw_px = -rig.disparity_offset_px if rig.offset_is_yaw else 0.0
    if corrected == VerticalDisparity() and yaw_px == 0.0:
        return None
    return RightCameraError(
        pitch_deg=float(np.rad2deg(corrected.pitch_px / rig.fx)),
        yaw_deg=float(np.rad2deg(yaw_px / rig.fx)),
        roll_deg=float(np.rad2deg(corrected.roll_px / rig.fx)),
        zoom_percent=100.0 * corrected.zoom_px / rig.fx,
        rows_px=float(np.abs(corrected.vertical_px(*_corners(rig))).max()),
    )


def _corners(rig: RectifiedRig) -> tuple[Floats, Floats]:
    """Those of the image, in pixels from the principal point over focal length."""
    u, v = np.array([(u, v) for u in (0, rig.width - 1) for v in (0, rig.height - 1)]).T
    return (u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy
