"""Positions of another sensor as text: NMEA 0183 of GPS receivers, and CSV with named columns."""

from __future__ import annotations

import csv
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from vo.base.errors import SourceError
from vo.base.types import Floats, Ints
from vo.recordings.formats.stamp_units import (
    POSES,
    STATED,
    StampText,
    StampUnit,
    parse_stamps,
    stamp_ns_from_seconds,
)
from vo.recordings.formats.table import table_text

_log = logging.getLogger(__name__)
_NS_PER_S = 1_000_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
NS_PER_DAY = 86_400 * _NS_PER_S
SIGMA_PER_DOP_M = 2.0  # horizontal error of a receiver, for one unit of dilution of precision
_STAMP_S = ("t", "time", "stamp", "timestamp", "time_s", "stamp_s", "seconds")
_STAMP_NS = ("stamp_ns", "time_ns", "timestamp_ns", "timestamp [ns]", "#timestamp [ns]")
_GEODETIC = (("latitude", "lat"), ("longitude", "lon", "lng"), ("altitude", "alt", "height"))
_SPEED = (
    ("speed", "v", "vx", "velocity", "speed_m_s", "speed_mps", "linear_x", "linear.x"),
    ("yaw_rate", "wz", "omega", "yawrate", "angular_z", "angular.z"),
)
_METRES = (("x", "tx", "x_m", "east"), ("y", "ty", "y_m", "north"), ("z", "tz", "z_m", "up"))


@dataclass(frozen=True, eq=False)
class PositionTable:
    """Positions in time order.

    Attributes:
        stamps_ns: (N,) increasing; Unix time, or time of day, see `is_time_of_day`.
        values: (N, 3) latitude and longitude in degrees and height in metres; or metres.
        sigma_m: (N,) standard deviation along one axis, NaN where unknown.
        is_geodetic: whether values are on WGS 84.
        is_time_of_day: whether the date is unknown.
    """

    stamps_ns: Ints
    values: Floats
    sigma_m: Floats
    is_geodetic: bool
    is_time_of_day: bool = False


def is_nmea(path: Path) -> bool:
    """Whether a file has a sentence with a position among its first lines."""
    return any(_sentence(line)[:1] in (["GGA"], ["RMC"]) for line in position_lines(path)[:200])


def read_nmea(path: Path) -> PositionTable:
    """Read the sentences GGA, with the dates of RMC and ZDA; sentences without a fix are left out.

    Source: NMEA 0183, sentences GGA, RMC and ZDA.
    """
    midnight: datetime | None = None
    first: datetime | None = None
    midnights: list[datetime | None] = []
    times_ns: list[int] = []
    values: list[list[float]] = []
    damaged = 0
    for line in position_lines(path):
        fields = _sentence(line)
        try:
            damaged += not fields and "$G" in line
            if not fields:
                continue
            midnight = _date(fields) or midnight
            first = first or midnight
            if fields[0] == "GGA" and fields[6] not in ("", "0"):
                position, time_ns = _gga(fields), _time_of_day_ns(fields[1])
                midnights.append(midnight)
                times_ns.append(time_ns)
                values.append(position)
        except (ValueError, IndexError):
            damaged += 1
    if damaged:
        _log.warning("%s: %d damaged NMEA sentences are left out", path, damaged)
    if not values:
        raise SourceError(f"{path} has no position (GGA with a fix); give another file of NMEA")
    table, stamps_ns = np.array(values), np.array(times_ns, np.int64)
    if first is not None:
        days = [((each or first) - _EPOCH).days for each in midnights]
        stamps_ns += NS_PER_DAY * np.array(days, np.int64)
    # Past midnight, without a new date or before the sentence that has it.
    turns = np.diff(stamps_ns, prepend=stamps_ns[0])
    late: Ints = np.cumsum(turns < -NS_PER_DAY // 2) - np.cumsum(turns > NS_PER_DAY // 2)
    stamps_ns += NS_PER_DAY * np.maximum(late, 0)
    return position_table(path, stamps_ns, table[:, :3], table[:, 3], True, first is None)


def read_position_csv(path: Path) -> PositionTable | None:
    """Read a CSV whose first line names a stamp and positions; None without such a line.

    Stamps are seconds in `time`, `t`, `stamp` or `timestamp`, nanoseconds in `stamp_ns`. Positions
    are `x`, `y` and perhaps `z` in metres, or `lat`, `lon` and perhaps `alt`.
    """
    found = _named_columns(path, (_GEODETIC, _METRES))
    if found is None:
        return None
    kind, stamps_ns, values = found
    positions = np.zeros((len(values), 3))
    positions[:, : values.shape[1]] = values
    unknown = np.full(len(values), np.nan)
    return position_table(path, stamps_ns, positions, unknown, kind is _GEODETIC)


def read_speed_csv(path: Path) -> tuple[Ints, Floats] | None:
    """Read a CSV whose first line names a stamp, a speed in m/s and perhaps a yaw rate in rad/s.

    Returns stamps (N,) as written, and (N, 1) or (N, 2) values; None without such a line.
    """
    found = _named_columns(path, (_SPEED,))
    return None if found is None else found[1:]


def _named_columns(
    path: Path, kinds: Sequence[Sequence[Sequence[str]]]
) -> tuple[Sequence[Sequence[str]], Ints, Floats] | None:
    """The first kind of values whose columns are there, stamps in nanoseconds, and the values."""
    lines = [line for line in position_lines(path) if line.strip()]
    names = [name.strip().lower() for name in next(csv.reader(lines[:1]), [])]
    in_ns = [names.index(name) for name in _STAMP_NS if name in names]
    in_s = [names.index(name) for name in _STAMP_S if name in names]
    there = [(kind, columns) for kind in kinds if (columns := _columns(names, kind)) is not None]
    if not (in_ns or in_s) or not there:
        return None
    kind, columns = there[0]
    stamps, values = [], []
    for number, row in enumerate(csv.reader(lines[1:]), start=2):
        try:
            text = row[(in_ns or in_s)[0]].strip()
            stamps.append(StampText(f"{path}:{number}", text))
            values.append([float(row[column]) for column in columns])
        except (ValueError, IndexError) as error:
            raise SourceError(f"{path}:{number}: {error}; give numbers in every line") from error
    if not values:
        raise SourceError(f"{path} has no line of data; give values with their times")
    unit: StampUnit
    unit, spacing = ("ns", STATED) if in_ns else ("s", POSES)
    stamps_ns = np.array(parse_stamps(stamps, unit, spacing=spacing), np.int64)
    return kind, stamps_ns, np.array(values)


def position_table(
    path: Path,
    stamps_ns: Ints,
    values: Floats,
    sigma_m: Floats,
    is_geodetic: bool,
    is_time_of_day: bool = False,
) -> PositionTable:
    """The finite positions, sorted by time, the first of each."""
    known = np.isfinite(values).all(axis=1)
    if is_geodetic:
        known &= (np.abs(values[:, 0]) <= 90.0) & (np.abs(values[:, 1]) <= 360.0)
    if not known.any():
        raise SourceError(f"{path} has no finite position")
    unique, rows = np.unique(stamps_ns[known], return_index=True)
    kept = np.flatnonzero(known)[rows]
    return PositionTable(unique, values[kept], sigma_m[kept], is_geodetic, is_time_of_day)


def position_lines(path: Path) -> list[str]:
    """The lines of a text file of positions."""
    missing = "does not exist; give a file of positions"
    not_text = "cannot be read as positions: it is not text"
    return table_text(path, missing, not_text, " as positions").splitlines()


def _columns(names: Sequence[str], wanted: Sequence[Sequence[str]]) -> list[int] | None:
    """Columns of the values; the last one may be missing."""
    found = [[names.index(name) for name in each if name in names] for each in wanted]
    if not all(found[:-1]):
        return None
    return [each[0] for each in found if each]


def _sentence(line: str) -> list[str]:
    """Fields of an NMEA sentence with its type first, as `GGA`; empty if it is damaged."""
    begin = line.find("$")
    body, star, rest = line[begin + 1 :].strip().partition("*")
    if begin < 0 or not body.isascii():
        return []
    if star:
        checksum = 0
        for byte in body.encode():
            checksum ^= byte
        if rest[:2].upper() != f"{checksum:02X}":
            return []
    name, *fields = body.split(",")
    return [name[2:], *fields] if name.startswith("G") or name[2:] in ("GGA", "RMC", "ZDA") else []


def _date(fields: Sequence[str]) -> datetime | None:
    if fields[0] == "RMC" and fields[2] == "A" and len(fields[9]) == 6:
        return datetime.strptime(fields[9], "%d%m%y").replace(tzinfo=UTC)
    if fields[0] == "ZDA" and fields[2]:
        return datetime(int(fields[4]), int(fields[3]), int(fields[2]), tzinfo=UTC)
    return None


def _time_of_day_ns(text: str) -> int:
    hours, minutes = int(text[:2]), int(text[2:4])
    return (hours * 3600 + minutes * 60) * _NS_PER_S + stamp_ns_from_seconds(text[4:])


def _gga(fields: Sequence[str]) -> list[float]:
    """Latitude, longitude, height above the ellipsoid, and standard deviation."""
    latitude = _degrees(fields[2], 2) * (-1.0 if fields[3] == "S" else 1.0)
    longitude = _degrees(fields[4], 3) * (-1.0 if fields[5] == "W" else 1.0)
    height = float(fields[9] or 0.0) + float(fields[11] or 0.0)
    dop = float(fields[8]) if fields[8] else float("nan")
    return [latitude, longitude, height, SIGMA_PER_DOP_M * dop if dop > 0.0 else float("nan")]


def _degrees(text: str, digits: int) -> float:
    return int(text[:digits]) + float(text[digits:]) / 60.0
