"""Conversion of ROS's CameraInfo and Foxglove's CameraCalibration to a camera."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.types import Camera
from vo.recordings.formats.calibration.checks import check_camera_matrix, make_camera
from vo.recordings.formats.calibration.numbers import check_rotation
from vo.recordings.formats.messages import CalibrationMessage

UNCALIBRATED = "K is zero: the camera was never calibrated; give a file with `calibration=FILE`"
_IDEAL = re.compile(
    r"plumb.?bob|rational.?polynomial|radtan|((inverse|modified).?)?brown.?conrady|pinhole|"
    r"perspective|thin.?prism"
)
"""Models without distortion if all coefficients are 0, those of RealSense's SDK among them."""


@dataclass(frozen=True, eq=False)
class RawCalibration:
    """Values of a calibration message, unchecked.

    Attributes:
        size: width and height of the calibrated image, before binning.
        r: (9,) rotation into the rectified camera, or empty.
        p: (12,) projection of the rectified camera, or empty.
        binning: sensor pixels per image pixel, along u and v; 0 means 1.
        roi_offset: top-left corner of the image on the sensor, in sensor pixels.
    """

    stamp_ns: int
    frame: str
    size: tuple[int, int]
    model: str
    d: Sequence[float]
    k: Sequence[float]
    r: Sequence[float]
    p: Sequence[float]
    binning: tuple[int, int] = (1, 1)
    roi_offset: tuple[int, int] = (0, 0)


def calibration_message(raw: RawCalibration) -> CalibrationMessage:
    """Check the values of a message and convert them."""
    where = f"calibration message of '{raw.frame}'"
    has_projection = len(raw.p) == 12 and raw.p[0] > 0 and raw.p[5] > 0
    is_rectified_only = not any(raw.k[:8]) and has_projection
    if is_rectified_only:
        k = np.reshape(raw.p, (3, 4))[:, :3].astype(float)
        raw = replace(raw, k=k.ravel().tolist(), model="plumb_bob", d=[])
    if len(raw.k) != 9 or not any(raw.k[:8]):
        raise CalibrationError(f"{where} is empty: {UNCALIBRATED}")
    check_camera_matrix(where, np.reshape(raw.k, (3, 3)))
    if not np.isfinite([*raw.r, *raw.p]).all():
        raise CalibrationError(f"{where}: R or P has numbers that are not finite")
    r = np.reshape(raw.r, (3, 3)) if len(raw.r) == 9 and any(raw.r) else np.eye(3)
    check_rotation(f"{where}: R", r)
    p = np.reshape(raw.p, (3, 4)) if len(raw.p) == 12 and any(raw.p) else np.zeros((3, 4))
    if not p.any():
        p[:, :3] = np.reshape(raw.k, (3, 3))
    # The values refer to the whole sensor, the image may be cropped and binned.
    bin_u, bin_v = (max(int(b), 1) for b in raw.binning)
    scale = np.array([[1 / bin_u, 0, 0], [0, 1 / bin_v, 0], [0, 0, 1.0]])
    crop = np.array([[1.0, 0, -raw.roi_offset[0]], [0, 1.0, -raw.roi_offset[1]], [0, 0, 1.0]])
    camera = _camera(raw, scale @ crop @ np.reshape(raw.k, (3, 3)), (bin_u, bin_v))
    return CalibrationMessage(
        raw.stamp_ns,
        raw.frame.lstrip("/"),
        camera,
        r.astype(float),
        scale @ crop @ p,
        is_rectified_only,
    )


def _camera(raw: RawCalibration, k: np.ndarray, binning: tuple[int, int]) -> Camera:
    model, coefficients = raw.model or "plumb_bob", [float(x) for x in raw.d]
    if not any(coefficients) and _IDEAL.fullmatch(model.lower()):
        model, coefficients = "none", []
    elif model.lower() == "plumb_bob" and not any(coefficients[5:]):
        coefficients = coefficients[:5]
    return make_camera(
        f"calibration message of '{raw.frame}'",
        [raw.size[0] // binning[0], raw.size[1] // binning[1]],
        [float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])],
        model,
        coefficients,
    )
