"""Conversion of values of a calibration file to numbers, lists and matrices, with checks."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import orthonormalised
from vo.base.types import Floats
from vo.recordings.formats.calibration.document import ImageSize, shortened

_ROTATION_TOLERANCE = 1e-3
_MAX_VALUE = 1e12
_MAX_IMAGE_SIDE = 100_000
_OF_REALSENSE = re.compile(r"(inverse|modified)[\W_]*brown[\W_]*conrady", re.IGNORECASE)


def make_resolution(where: str, value: Any) -> ImageSize:
    """Width and height as positive whole numbers."""
    if value is None:
        raise CalibrationError(f"{where}: resolution is missing; add resolution: [width, height]")
    sides = make_numbers(f"{where}: resolution [width, height]", value, 2)
    if not all(1 <= side <= _MAX_IMAGE_SIDE and side.is_integer() for side in sides):
        raise CalibrationError(
            f"{where}: resolution is {shortened(value)}; width and height must be whole numbers "
            "above 0"
        )
    return int(sides[0]), int(sides[1])


def make_numbers(what: str, value: Any, count: int | None = None) -> tuple[float, ...]:
    """A list of finite numbers.

    Text that is a number is accepted, because YAML 1.1 reads `1e-3` as text.
    """
    if not is_list(value):
        raise CalibrationError(f"{what} is {shortened(value)}; it must be a list of numbers")
    if count is not None and len(value) != count:
        raise CalibrationError(f"{what} has {len(value)} numbers; {count} are needed")
    return tuple(make_number(f"{what}, number {i}", item) for i, item in enumerate(value, 1))


def make_number(what: str, value: Any) -> float:
    """A finite number."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not abs(number) <= _MAX_VALUE:
        shown = value if isinstance(value, str) else shortened(value)
        raise CalibrationError(f"{what} is {shown[:80]}; it must be a finite number")
    return number


def make_positive(what: str, value: Any, advice: str = "it must be above 0") -> float:
    """A number above 0."""
    number = make_number(what, value)
    if number <= 0:
        raise CalibrationError(f"{what} is {number:g}; {advice}")
    return number


def unsupported(what: str, known: Iterable[str]) -> CalibrationError:
    """The error for a model that is not supported."""
    advice = ""
    if _OF_REALSENSE.search(what):
        advice = (
            "; versions of RealSense's SDK distort by it, or undistort: calibrate the camera with "
            "`vo calibrate`"
        )
    return CalibrationError(f"{what} is not supported; supported are {', '.join(known)}{advice}")


def is_list(value: Any) -> TypeGuard[Sequence[Any]]:
    """Whether a value is a list, not a text."""
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def make_matrix(what: str, value: Any, rows: int, columns: int) -> Floats:
    """A (rows, columns) matrix from a list of rows, a flat list, or a section with data.

    A section, as in EuRoC, ROS and OpenCV, has the keys rows, cols and data (row by row).
    """
    if isinstance(value, Mapping):
        value = value.get("data")
    if value is None:
        raise CalibrationError(f"{what} is missing; {rows * columns} numbers are needed")
    if _are_rows(value) and len(value) == rows:
        parts = [make_numbers(f"{what}, row {i}", row, columns) for i, row in enumerate(value, 1)]
        return np.array(parts)
    return np.array(make_numbers(what, value, rows * columns)).reshape(rows, columns)


def make_list(what: str, value: Any) -> tuple[float, ...]:
    """All numbers of a list, a row, a column, or a section with data; empty if missing."""
    if isinstance(value, Mapping):
        if "data" not in value:
            raise CalibrationError(f"{what} is {shortened(value)}; it must be a list of numbers")
        value = value["data"]
    if value is None:
        return ()
    if _are_rows(value):
        return tuple(number for row in value for number in make_numbers(what, row))
    return make_numbers(what, value)


def make_transform(where: str, value: Any) -> Floats:
    """A (4, 4) rigid transform from three or four rows of four, or a flat list of 12 or 16.

    The rotation is orthonormalised, because files contain rounded values.
    """
    given = value.get("data") if isinstance(value, Mapping) else value
    size = len(given) if isinstance(given, Sequence) else 0
    rows = 3 if size in (3, 12) else 4
    matrix = np.eye(4)
    matrix[:rows] = make_matrix(where, value, rows, 4)
    if np.any(matrix[3, :3]) and not np.any(matrix[:3, 3]):
        raise CalibrationError(f"{where}: the matrix is transposed; write it row by row")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-9:
        raise CalibrationError(f"{where}: the last row is {matrix[3].tolist()}, not [0, 0, 0, 1]")
    check_rotation(where, matrix[:3, :3])
    return orthonormalised(matrix)


def check_rotation(where: str, rotation: Floats) -> None:
    """Refuse a (3, 3) matrix that is not a rotation."""
    defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if not defect <= _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:  # NaN included
        raise CalibrationError(
            f"{where}: the rotation is not orthonormal (off by {defect:.2g}, determinant "
            f"{np.linalg.det(rotation):.4g}); check that it is complete and row by row"
        )


def _are_rows(value: Any) -> bool:
    return is_list(value) and len(value) > 0 and all(map(is_list, value))
