"""Creation of cameras from values of a calibration file, with checks for plausibility."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.distortion import centre_scale
from vo.base.types import Camera, Floats
from vo.recordings.formats.calibration.lenses import (
    DISTORTION_NAMES,
    PROJECTIONS,
    check_lens,
    join_projection,
    make_lens,
)
from vo.recordings.formats.calibration.numbers import (
    check_rotation,
    make_list,
    make_matrix,
    make_number,
    make_numbers,
    make_resolution,
    make_transform,
)
from vo.recordings.formats.warning_kinds import warning_kind

__all__ = [
    "DISTORTION_NAMES",
    "check_baseline",
    "check_rotation",
    "make_camera",
    "make_list",
    "make_matrix",
    "make_number",
    "make_numbers",
    "make_readout",
    "make_resolution",
    "make_transform",
]

_MIN_BASELINE_M = 1e-6
_MAX_BASELINE_M = 10.0
_MIN_FOCAL_PX = 1e-3
_MAX_READOUT_S = 0.2
_PLAUSIBLE_FOCAL_RATIO = (0.1, 20.0)
"""Focal length over image width: pinhole cameras with fields of view of 157 and 3 degrees."""

_log = logging.getLogger(__name__)


def make_camera(
    where: str,
    *,
    model: Any,
    resolution: Any,
    intrinsics: Any,
    distortion_model: Any,
    distortion: Any,
) -> Camera:
    """Create a camera from the values in a file.

    Args:
        where: file and section, for error messages.
        model: Kalibr's name of the projection, a key of `PROJECTIONS`.
        resolution: width and height in pixels.
        intrinsics: parameters of the projection model, then fx, fy, cx, cy in pixels.
        distortion_model: a key of `DISTORTION_NAMES`, or None without distortion.
        distortion: distortion coefficients.
    """
    if not isinstance(model, str) or model not in PROJECTIONS:
        known = ", ".join(f"'{name}'" for name in PROJECTIONS)
        raise CalibrationError(
            f"{where}: camera model {str(model)[:40]!r} is not supported; supported are {known}"
        )
    width, height = make_resolution(where, resolution)
    names = (*PROJECTIONS[model][1], "fx", "fy", "cx", "cy")
    numbers = make_numbers(f"{where}: intrinsics [{', '.join(names)}]", intrinsics, len(names))
    fx, fy, cx, cy = numbers[-4:]
    lens = make_lens(where, distortion_model, distortion)
    name, coefficients = join_projection(where, model, numbers[:-4], lens)
    camera = Camera(width, height, fx, fy, cx, cy, name, coefficients)
    check_lens(where, camera)
    _check_pinhole(where, camera)
    return camera


def make_readout(where: str, value: Any) -> float:
    """Time from the first to the last row of an image, in seconds; 0 for None."""
    readout_s = 0.0 if value is None else make_number(where, value)
    if not 0.0 <= readout_s <= _MAX_READOUT_S:
        raise CalibrationError(
            f"{where} is {readout_s:g}; it is the time from the first to the last row of an image "
            f"in seconds, from 0 (global shutter) to {_MAX_READOUT_S:g}"
        )
    return readout_s


def check_baseline(where: str, cam1_from_cam0: Floats) -> None:
    """Refuse a baseline of zero, and warn of an implausibly long one."""
    baseline = float(np.linalg.norm(cam1_from_cam0[:3, 3]))
    if baseline < _MIN_BASELINE_M:
        raise CalibrationError(
            f"{where}: the baseline is {baseline:g} m, so depth cannot be measured; give the "
            "distance between the cameras in metres, or use one camera with --mode mono"
        )
    if baseline > _MAX_BASELINE_M:
        _log.warning(
            "%s: the baseline is %g m; if the unit is millimetres, all lengths will be 1000 times "
            "too large",
            where,
            baseline,
            extra=warning_kind("large_baseline"),
        )


def _check_pinhole(where: str, camera: Camera) -> None:
    if min(camera.fx, camera.fy) < _MIN_FOCAL_PX:
        raise CalibrationError(
            f"{where}: focal length is {camera.fx:g}, {camera.fy:g}; it must be above 0 pixels"
        )
    off_u = _outside(camera.cx, camera.width)
    off_v = _outside(camera.cy, camera.height)
    if max(off_u, off_v) > 0.5:
        raise CalibrationError(
            f"{where}: principal point ({camera.cx:g}, {camera.cy:g}) is far outside the "
            f"{camera.width}x{camera.height} image; intrinsics are [fx, fy, cx, cy] in pixels"
        )
    if max(off_u, off_v) > 0.0:
        _log.warning(
            "%s: principal point (%g, %g) is outside the %dx%d image; check that the calibration "
            "is for images of this size",
            where,
            camera.cx,
            camera.cy,
            camera.width,
            camera.height,
        )
    ratio = centre_scale(camera) * camera.fx / camera.width
    if not _PLAUSIBLE_FOCAL_RATIO[0] <= ratio <= _PLAUSIBLE_FOCAL_RATIO[1]:
        field_of_view_deg = 2.0 * math.degrees(math.atan(0.5 / ratio))
        _log.warning(
            "%s: a focal length of %g for %d pixels is a field of view of %.3g degrees; check the "
            "unit (pixels) and the size of the images",
            where,
            camera.fx,
            camera.width,
            field_of_view_deg,
        )


def _outside(centre: float, size: int) -> float:
    """Distance outside the image, as a fraction of its size; 0 inside."""
    return max(-centre, centre - size, 0.0) / size
