"""Numbers, lists and matrices from a calibration file, or why they cannot be true."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vo.errors import CalibrationError
from vo.formats.calibration.document import ImageSize, shortened
from vo.geometry.transforms import orthonormalised
from vo.types import Floats

_ROTATION_TOLERANCE = 1e-3
_LARGEST = 1e12
_WIDEST_IMAGE = 100_000


def make_resolution(where: str, value: Any) -> ImageSize:
    """Width and height as positive whole numbers.

    Raises:
        CalibrationError: they are missing or not positive whole numbers.
    """
    if value is None:
        raise CalibrationError(f"{where}: resolution is missing; add resolution: [width, height]")
    sides = make_numbers(f"{where}: resolution [width, height]", value, 2)
    if not all(1 <= side <= _WIDEST_IMAGE and side.is_integer() for side in sides):
        raise CalibrationError(
            f"{where}: resolution is {shortened(value)}; width and height must be whole numbers "
            "above 0"
        )
    return int(sides[0]), int(sides[1])


def make_numbers(what: str, value: Any, count: int | None = None) -> tuple[float, ...]:
    """A list of finite numbers.

    YAML 1.1 reads `1e-3` as text, so text that is a number counts as one.

    Raises:
        CalibrationError: not a list, not `count` long, or an element is no finite number.
    """
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        raise CalibrationError(f"{what} is {shortened(value)}; a list of numbers is needed")
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
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not abs(number) <= _LARGEST:
        shown = value if isinstance(value, str) else shortened(value)
        raise CalibrationError(f"{what} is {shown[:80]}; a finite number is needed")
    return number


def make_matrix(what: str, value: Any, rows: int, columns: int) -> Floats:
    """A (rows, columns) matrix from its rows, all its numbers in one list, or a section with data.

    The section is EuRoC's, ROS's and OpenCV's way: rows, cols and data, row by row.

    Raises:
        CalibrationError: it has another shape, or an element is no finite number.
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
    """All numbers of a list, a row, a column, or a section with data; none where it is missing.

    Raises:
        CalibrationError: an element is no finite number.
    """
    if isinstance(value, Mapping):
        value = value.get("data")
    if value is None:
        return ()
    if _are_rows(value):
        return tuple(number for row in value for number in make_numbers(what, row))
    return make_numbers(what, value)


def make_transform(where: str, value: Any) -> Floats:
    """A (4, 4) rigid transform from four rows of four, three rows of four, or 16 numbers.

    Its rotation is made exactly orthonormal, as files give it rounded.

    Raises:
        CalibrationError: a number is missing or the rotation is none.
    """
    given = value.get("data") if isinstance(value, Mapping) else value
    size = len(given) if isinstance(given, Sequence) else 0
    rows = 3 if size in (3, 12) else 4
    matrix = np.eye(4)
    matrix[:rows] = make_matrix(where, value, rows, 4)
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-9:
        raise CalibrationError(f"{where}: the last row is {matrix[3].tolist()}, not [0, 0, 0, 1]")
    check_rotation(where, matrix[:3, :3])
    return orthonormalised(matrix)


def check_rotation(where: str, rotation: Floats) -> None:
    """Refuse a (3, 3) matrix that is no rotation.

    Raises:
        CalibrationError: it is off from orthonormal by more than rounding, or a reflection.
    """
    defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if defect > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise CalibrationError(
            f"{where}: the rotation is not orthonormal (off by {defect:.2g}, determinant "
            f"{np.linalg.det(rotation):.4g}); check that it is complete and row by row"
        )


def _are_rows(value: Any) -> bool:
    return (
        isinstance(value, Sequence)
        and not isinstance(value, str | bytes)
        and len(value) > 0
        and all(isinstance(row, Sequence) and not isinstance(row, str | bytes) for row in value)
    )
