"""Reader of text files with one record of numbers per line."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_table_text
from vo.base.types import Floats
from vo.recordings.formats.headings import (
    POSITION,
    QUATERNION,
    axis_columns,
    heading_of,
    stamp_column,
)

_log = logging.getLogger(__name__)
_MAX_VALUE = 1e12
_TUM_ORDER = (0, 1, 2, 3, 7, 4, 5, 6)  # in that of EuRoC


class Line(NamedTuple):
    """A line of data: its file and number, its fields and their separator."""

    file: Path
    number: int
    fields: list[str]
    has_commas: bool

    @property
    def location(self) -> str:
        """Where it is, for messages."""
        return f"{self.file}:{self.number}"

    @property
    def text(self) -> str:
        """The first field, which is the stamp in most tables."""
        return self.fields[0]


def table_text(path: Path, missing: str, not_text: str = "is not text", role: str = "") -> str:
    """The text of a table; messages say what is `missing` or `not_text`, and what for (`role`)."""
    try:
        return read_table_text(path)
    except FileNotFoundError as error:
        raise SourceError(f"{path} {missing}") from error
    except UnicodeDecodeError as error:
        raise SourceError(f"{path} {not_text}") from error
    except OSError as error:
        raise SourceError(f"{path} cannot be read{role}: {error.strerror or error}") from error


def read_table(path: Path) -> list[Line]:
    """Read the lines of data, without comments, blank lines and a CSV header.

    An incomplete last line, left by a program that was killed, is dropped with a warning.
    """
    return _table(path)[0]


def _table(path: Path) -> tuple[list[Line], list[str]]:
    """The lines of data, see `read_table`, and all lines as text."""
    text = table_text(
        path,
        "does not exist; give the path of a trajectory file",
        "is not text; trajectories are TUM, KITTI or EuRoC text",
    )
    texts = text.splitlines()
    lines = _data_lines(path, texts)
    if lines and not _is_number(lines[0].fields[0]) and stamp_column(lines[0].fields) is not None:
        lines = lines[1:]
    if len(lines) > 1 and text[-1] != "\n" and len(lines[-1].fields) < len(lines[-2].fields):
        _log.warning("%s: the last line is cut off and left out", lines[-1].location)
        lines.pop()
    if not lines:
        raise SourceError(f"{path} has no line of data; give a trajectory with at least one pose")
    return lines, texts


def read_poses_table(path: Path) -> list[Line]:
    """As `read_table`; where a heading names the columns of poses, in the order of the format.

    With commas it is that of EuRoC, with qw before qx; without, that of TUM.
    """
    lines, texts = _table(path)
    names = heading_of(texts)
    stamp, position = stamp_column(names), axis_columns(names, POSITION)
    quaternion = axis_columns(names, QUATERNION, "wxyz" if lines[0].has_commas else "xyzw")
    if stamp is None or position is None or quaternion is None:
        return _as_euroc(path, lines) if _is_tum_with_commas(lines[0]) else lines
    order = [column.number for column in (stamp, *position, *quaternion)]
    if order == list(range(len(order))):
        return lines
    _log.warning("%s: columns are taken by the names in its heading, not by their order", path)
    check_columns(lines, max(order) + 1, exactly=False)
    return [line._replace(fields=[line.fields[number] for number in order]) for line in lines]


def _is_tum_with_commas(line: Line) -> bool:
    """Whether eight columns begin with seconds, which EuRoC, with its other order, has not."""
    stamp = line.fields[0]
    is_seconds = re.fullmatch(r"\d{1,10}\.\d+", stamp) is not None
    return line.has_commas and len(line.fields) == len(_TUM_ORDER) and is_seconds


def _as_euroc(path: Path, lines: list[Line]) -> list[Line]:
    _log.warning("%s: read as TUM with commas, stamp x y z qx qy qz qw", path)
    check_columns(lines, len(_TUM_ORDER), exactly=True)
    return [line._replace(fields=[line.fields[number] for number in _TUM_ORDER]) for line in lines]


def _data_lines(path: Path, texts: list[str]) -> list[Line]:
    lines = []
    for number, text in enumerate(texts, start=1):
        text = text.strip()
        if not text or text[0] == "#":
            continue
        has_commas = "," in text
        fields = text.split("," if has_commas else None)
        if has_commas and len(text.split(None, 1)) > 1:
            fields = [field.strip() for field in fields]
        lines.append(Line(path, number, fields, has_commas))
    return lines


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def check_columns(lines: list[Line], columns: int, *, exactly: bool) -> None:
    """Refuse lines with another number of columns."""
    for line in lines:
        found = len(line.fields)
        if found < columns or (exactly and found > columns):
            at_least = "" if exactly else "at least "
            raise SourceError(f"{line.location}: {found} columns, {at_least}{columns} expected")


def parse_columns(lines: list[Line], start: int, stop: int) -> Floats:
    """Parse columns start to stop - 1 as (N, stop - start) numbers, which may be NaN."""
    rows, line = [], lines[0]
    try:
        for line in lines:
            rows.append([float(field) for field in line.fields[start:stop]])
    except ValueError as error:
        raise SourceError(f"{line.location}: {error}; every column must be a number") from error
    values = np.array(rows, dtype=np.float64).reshape(len(lines), stop - start)
    implausible = np.isfinite(values) & (np.abs(values) > _MAX_VALUE)
    if implausible.any():
        i, j = np.argwhere(implausible)[0]
        found = lines[i].fields[start + j]
        column = start + j + 1
        raise SourceError(f"{lines[i].location}: column {column} is {found}; remove the line")
    return values
