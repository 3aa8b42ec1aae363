"""Columns of tables by the names in their heading, whatever their order and units."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_UNIT = re.compile(r"[\[(](.*?)[\])]|[_ ](deg/?_?s|dps|rad/?_?s|m/?_?s\^?2|mg|g|ns|us|ms|s|sec)$")
_PREFIX = r"(?:field)?(?:imu\d?)?"
_STAMP = re.compile(r"(?:.*timestamp.*|time.*|.*stamp|t|sec|seconds)")
GYRO = r"gyro|gyr|gyroscope|omega|alpha|angularvelocity|angvel|angularrate|rotationrate|wrss|w|g"
ACCEL = r"acc|accel|acceleration|accelerometer|linearacceleration|linacc|specificforce|arss|a|f"
POSITION = r"(?:pose)*(?:p|prsr|prs|pos|position|t|trans|translation|)"
QUATERNION = r"(?:pose)*(?:q|qrs|qrsr|quat|quaternion|orientation|rot|rotation)"
_FACTORS = {
    "deg": np.pi / 180.0,
    "°": np.pi / 180.0,
    "dps": np.pi / 180.0,
    "mg": 9.80665e-3,
    "g": 9.80665,
}


class Column(NamedTuple):
    """Number of a column, and the unit in its name, empty without one."""

    number: int
    unit: str

    @property
    def factor(self) -> float:
        """From the unit to SI; 1 without a unit, or for one that is SI."""
        unit = self.unit.lower().strip()
        found = (factor for word, factor in _FACTORS.items() if unit.startswith(word))
        return 1.0 if unit.startswith(("gauss", "gr")) else next(found, 1.0)


def heading_of(lines: Sequence[str]) -> list[str]:
    """Names of columns in the last line before the data, perhaps a comment; empty without one."""
    names: list[str] = []
    for line in lines:
        fields = split_fields(line.lstrip("#% \t"))
        if not line.strip():
            continue
        if not line.lstrip().startswith("#") and _is_number(fields[0]):
            return names if len(names) >= len(fields) else []
        names = fields
    return []


def split_fields(line: str) -> list[str]:
    """The fields of a line, between commas, semicolons or white space."""
    for mark in ",;":
        if mark in line:
            return [field.strip() for field in line.split(mark)]
    return line.split()


def stamp_column(names: Sequence[str]) -> Column | None:
    """The first column whose name is that of a time."""
    columns = (Column(number, _parts(name)[1]) for number, name in enumerate(names))
    return next((c for c in columns if _STAMP.fullmatch(_parts(names[c.number])[0])), None)


def axis_columns(names: Sequence[str], quantity: str, axes: str = "xyz") -> list[Column] | None:
    """The columns of a quantity along axes; None unless there is exactly one for each."""
    found = []
    for axis in axes:
        pattern = re.compile(rf"{_PREFIX}(?:{quantity}){axis}|{axis}(?:{quantity})")
        columns = [
            Column(number, unit)
            for number, name in enumerate(names)
            for word, unit in [_parts(name)]
            if pattern.fullmatch(word)
        ]
        if len(columns) != 1:
            return None
        found += columns
    return found


def _parts(name: str) -> tuple[str, str]:
    """The letters and digits of a name without its unit, and the unit."""
    unit = _UNIT.search(name)
    word = name if unit is None else name[: unit.start()] + name[unit.end() :]
    word = re.sub(r"[^a-z0-9]|axis", "", word.lower())
    return word, "" if unit is None else (unit[1] or unit[2] or "")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
