"""Errors of a calibration, as the corrections of a run show them."""

from __future__ import annotations

from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import VerticalDisparity
from vo.base.records.calibration_errors import CalibrationErrors, LensError
from vo.engine.geometry.k1_error import edge_shift_px
from vo.engine.geometry.right_camera_error import right_camera_error


def corrected_errors(rig: RectifiedRig, corrected: VerticalDisparity) -> CalibrationErrors:
    """The errors that are corrected in a rig, and in its right images."""
    k1 = rig.k1_error
    return CalibrationErrors(
        disparity_offset_px=rig.disparity_offset_px,
        disparity_curve_px=rig.disparity_curve_px,
        right_camera=right_camera_error(corrected, rig),
        lens_error=LensError(k1, edge_shift_px(rig, k1)) if k1 != 0.0 else None,
    )
