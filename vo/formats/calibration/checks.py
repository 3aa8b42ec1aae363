"""Turns numbers from a calibration file into cameras and transforms, or says why it cannot."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vo.errors import CalibrationError
from vo.formats.calibration.document import ImageSize
from vo.geometry.transforms import orthonormalised
from vo.types import Camera, DistortionModel, Floats

DISTORTION_NAMES: dict[str, DistortionModel] = {
    "none": "none",
    "radtan": "radtan",
    "radtan5": "radtan",
    "radtan8": "radtan",
    "radial-tangential": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "equidistant": "equidistant",
    "kannala_brandt": "equidistant",
    "fisheye": "equidistant",
}
_COUNTS: dict[DistortionModel, tuple[int, ...]] = {
    "none": (0,),
    "radtan": (4, 5, 8),
    "equidistant": (4,),
}
_ROTATION_TOLERANCE = 1e-3
_SHORTEST_BASELINE_M = 1e-6
_LONGEST_BASELINE_M = 10.0
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
    """Check the values that a file gives for one camera.

    Args:
        where: file and section, for messages.
        model: name of the projection; only `pinhole` is understood.
        resolution: width and height in pixels.
        intrinsics: fx, fy, cx, cy in pixels.
        distortion_model: a key of `DISTORTION_NAMES`, or None for none.
        distortion: the coefficients.

    Raises:
        CalibrationError: a value is missing, not a number or cannot be true.
    """
    if model != "pinhole":
        raise CalibrationError(f"{where}: camera model {model!r} is not known; 'pinhole' is")
    width, height = make_resolution(where, resolution)
    fx, fy, cx, cy = make_numbers(f"{where}: intrinsics [fx, fy, cx, cy]", intrinsics, 4)
    name, coefficients = _make_distortion(where, distortion_model, distortion)
    camera = Camera(width, height, fx, fy, cx, cy, name, coefficients)
    _check_pinhole(where, camera)
    return camera


def make_resolution(where: str, value: Any) -> ImageSize:
    """Width and height as positive whole numbers.

    Raises:
        CalibrationError: they are missing or not positive whole numbers.
    """
    if value is None:
        raise CalibrationError(f"{where}: resolution is missing; add resolution: [width, height]")
    width, height = make_numbers(f"{where}: resolution [width, height]", value, 2)
    if not (width >= 1 and height >= 1 and width.is_integer() and height.is_integer()):
        raise CalibrationError(
            f"{where}: resolution is {value}; width and height must be whole numbers above 0"
        )
    return int(width), int(height)


def make_numbers(what: str, value: Any, count: int | None = None) -> tuple[float, ...]:
    """A list of finite numbers.

    YAML 1.1 reads `1e-3` as text, so text that is a number counts as one.

    Raises:
        CalibrationError: not a list, not `count` long, or an element is no finite number.
    """
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise CalibrationError(f"{what} is {value!r}; a list of numbers is needed")
    if count is not None and len(value) != count:
        raise CalibrationError(f"{what} has {len(value)} numbers; {count} are needed")
    return tuple(make_number(f"{what}, number {i}", item) for i, item in enumerate(value, 1))


def make_number(what: str, value: Any) -> float:
    """One finite number.

    Raises:
        CalibrationError: it is something else.
    """
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise CalibrationError(f"{what} is {value}; a finite number is needed")
    return number


def make_transform(where: str, value: Any) -> Floats:
    """A (4, 4) rigid transform from four rows of four, three rows of four, or 16 numbers.

    Its rotation is made exactly orthonormal, as files give it rounded.

    Raises:
        CalibrationError: a number is missing or the rotation is none.
    """
    matrix = np.eye(4)
    rows = _as_rows(where, value)
    matrix[: len(rows)] = rows
    rotation = matrix[:3, :3]
    defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if defect > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise CalibrationError(
            f"{where}: the rotation is not orthonormal (off by {defect:.2g}, determinant "
            f"{np.linalg.det(rotation):.4g}); check that the 4x4 is complete and row by row"
        )
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-9:
        raise CalibrationError(f"{where}: the last row is {matrix[3].tolist()}, not [0, 0, 0, 1]")
    return orthonormalised(matrix)


def check_baseline(where: str, cam1_from_cam0: Floats) -> None:
    """Refuse two cameras in one place, and warn of a distance that no rig has.

    Raises:
        CalibrationError: their distance is zero.
    """
    baseline = float(np.linalg.norm(cam1_from_cam0[:3, 3]))
    if baseline < _SHORTEST_BASELINE_M:
        raise CalibrationError(
            f"{where}: the baseline is {baseline:g} m, so depth cannot be measured; give the "
            "distance between the cameras in metres, or use one camera with --mode mono"
        )
    if baseline > _LONGEST_BASELINE_M:
        _log.warning(
            "%s: the baseline is %g m; if that is millimetres, every length will be 1000 times "
            "too large",
            where,
            baseline,
        )


def _as_rows(where: str, value: Any) -> Floats:
    if isinstance(value, Mapping):  # as EuRoC writes matrices: cols, rows, data
        value = value.get("data")
    if isinstance(value, Sequence) and len(value) in (3, 4) and not isinstance(value, str):
        rows = [make_numbers(f"{where}, row {i}", row, 4) for i, row in enumerate(value, 1)]
        return np.array(rows)
    return np.array(make_numbers(where, value, 16)).reshape(4, 4)


def _make_distortion(
    where: str, model: Any, coefficients: Any
) -> tuple[DistortionModel, tuple[float, ...]]:
    name = DISTORTION_NAMES.get("none" if model is None else str(model).lower())
    if name is None:
        raise CalibrationError(
            f"{where}: distortion model {model!r} is not known; give one of "
            f"{', '.join(DISTORTION_NAMES)}"
        )
    numbers = make_numbers(f"{where}: distortion", [] if coefficients is None else coefficients)
    if model is None and numbers:
        raise CalibrationError(
            f"{where}: distortion has {len(numbers)} coefficients but distortion_model is missing"
        )
    if name == "none" and not any(numbers):
        return "none", ()
    if len(numbers) not in _COUNTS[name]:
        counts = " or ".join(str(count) for count in _COUNTS[name])
        raise CalibrationError(
            f"{where}: distortion has {len(numbers)} coefficients; {model} takes {counts}"
        )
    return name, numbers


def _check_pinhole(where: str, camera: Camera) -> None:
    if camera.fx <= 0 or camera.fy <= 0:
        raise CalibrationError(
            f"{where}: focal length is {camera.fx:g}, {camera.fy:g}; it must be above 0 pixels"
        )
    inside_u = -0.5 * camera.width < camera.cx < 1.5 * camera.width
    inside_v = -0.5 * camera.height < camera.cy < 1.5 * camera.height
    if not (inside_u and inside_v):
        raise CalibrationError(
            f"{where}: principal point ({camera.cx:g}, {camera.cy:g}) is far outside the "
            f"{camera.width}x{camera.height} image; intrinsics are [fx, fy, cx, cy] in pixels"
        )
