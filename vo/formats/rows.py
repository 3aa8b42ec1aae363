"""Lines of numbers in a text file, each with its place for messages."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.errors import SourceError
from vo.types import Floats

_log = logging.getLogger(__name__)
_LARGEST = 1e12


class Row(NamedTuple):
    """One line of data: where it stands, for messages, its fields and what divided them."""

    place: str
    fields: list[str]
    has_commas: bool


def read_rows(path: Path) -> list[Row]:
    """The lines of data, without comments, blank lines and a CSV's heading.

    Nor with a last line that was cut off, as that of a program that was killed.

    Raises:
        SourceError: the file is missing, not text or without data.
    """
    if path.exists() and not path.is_file() and not path.is_dir():  # it may have no end
        raise SourceError(f"{path} is no file but a device or a pipe; give a trajectory file")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise SourceError(f"{path} does not exist; give the path of a trajectory file") from error
    except UnicodeDecodeError as error:
        raise SourceError(
            f"{path} is not text; trajectories are TUM, KITTI or EuRoC text"
        ) from error
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror or error}") from error
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        has_commas = "," in line
        fields = [f.strip() for f in line.split(",")] if has_commas else line.split()
        rows.append(Row(f"{path}:{number}", fields, has_commas))
    if rows and not _is_number(rows[0].fields[0]) and "timestamp" in rows[0].fields[0].lower():
        rows = rows[1:]
    if len(rows) > 1 and text[-1] != "\n" and len(rows[-1].fields) < len(rows[-2].fields):
        _log.warning("%s: the last line is cut off and left out", rows[-1].place)
        rows.pop()
    if not rows:
        raise SourceError(f"{path} has no line of data; give a trajectory with at least one pose")
    return rows


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def need_columns(rows: list[Row], columns: int, *, exactly: bool) -> None:
    """Refuse lines with another number of columns.

    Raises:
        SourceError: naming the first.
    """
    for row in rows:
        found = len(row.fields)
        if found < columns or (exactly and found > columns):
            at_least = "" if exactly else "at least "
            raise SourceError(f"{row.place}: {found} columns, {at_least}{columns} expected")


def numbers(rows: list[Row], start: int, stop: int) -> Floats:
    """Columns start..stop-1 as (N, stop - start) numbers, finite ones within reason.

    Raises:
        SourceError: naming the first line with something else.
    """
    values = np.empty((len(rows), stop - start))
    for i, row in enumerate(rows):
        try:
            values[i] = [float(field) for field in row.fields[start:stop]]
        except ValueError as error:
            raise SourceError(f"{row.place}: {error}; every column must be a number") from error
    impossible = np.isfinite(values) & (np.abs(values) > _LARGEST)
    if impossible.any():
        i, j = np.argwhere(impossible)[0]
        found = rows[i].fields[start + j]
        raise SourceError(f"{rows[i].place}: column {start + j + 1} is {found}; remove the line")
    return values
