"""Tables of inertial samples: in EuRoC's order, or by the names of the columns."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.base.errors import SourceError
from vo.base.geometry.quantiles import median
from vo.recordings.formats.headings import (
    ACCEL,
    GYRO,
    axis_columns,
    heading_of,
    split_fields,
    stamp_column,
)
from vo.recordings.formats.stamp_units import (
    MAX_STAMP_NS,
    NS_PER_UNIT,
    SAMPLES,
    STATED,
    StampText,
    StampUnit,
    parse_all_ns,
    parse_stamps,
)
from vo.recordings.formats.table import table_text
from vo.recordings.sources.imu import ImuSamples, make_samples

_log = logging.getLogger(__name__)
_HEADING_LINES = 20
_MISSING = "is missing; it should contain the inertial samples"


class _Layout(NamedTuple):
    """Columns of the stamp and of gyro x, y, z and accel x, y, z, with factors to SI units."""

    stamp: int = 0
    values: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    factors: tuple[float, ...] = (1.0,) * 6
    unit: str = ""


def read_imu_table(table: Path) -> ImuSamples:
    """Read angular rates in rad/s and accelerations in m/s² with their stamps.

    A heading says the order and units of columns; without one they are those of EuRoC, and stamps
    are nanoseconds unless their rate says otherwise. Damaged lines are skipped, with a warning.
    """
    lines = [line for line in table_text(table, _MISSING).splitlines() if line.strip()]
    layout = _layout(table, lines[:_HEADING_LINES])
    data = [line for line in lines if line.lstrip()[0] != "#"]
    if data and not any(character.isdigit() for character in split_fields(data[0])[layout.stamp]):
        data = data[1:]
    if not data:
        raise SourceError(f"{table} has no data; it must have one line per sample")
    read = _all_at_once(data, layout) or _one_by_one(table, data, layout)
    for count, reason in ((read.unreadable, "cannot be read"), (read.repeated, "repeat a stamp")):
        if count:
            _log.warning("%s: %d of %d lines %s and are skipped", table, count, len(data), reason)
    return read


def _layout(table: Path, lines: Sequence[str]) -> _Layout:
    names = heading_of(lines)
    if not names:
        return _Layout()
    stamp, gyro, accel = stamp_column(names), axis_columns(names, GYRO), axis_columns(names, ACCEL)
    if stamp is None or gyro is None or accel is None:
        _log.warning(
            "%s: the heading '%s' does not name stamp, gyro and accel of x, y and z: these are "
            "taken to be the first seven columns, in this order",
            table,
            ", ".join(names)[:200],
        )
        return _Layout()
    columns = [*gyro, *accel]
    numbers, factors = [c.number for c in columns], [c.factor for c in columns]
    return _Layout(stamp.number, tuple(numbers), tuple(factors), stamp.unit.lower().strip())


def _all_at_once(lines: list[str], layout: _Layout) -> ImuSamples | None:
    """Samples of lines that are all well-formed, in a third of the time; None if some are not."""
    if layout.stamp or layout.unit not in ("", "ns") or "," not in lines[0]:
        return None
    try:
        stamps = parse_all_ns([text.partition(",")[0].strip() for text in lines])
        values = np.loadtxt(lines, delimiter=",", comments=None, usecols=layout.values, ndmin=2)
    except ValueError:
        return None
    interval = median(np.diff(stamps)) if len(stamps) > 1 else SAMPLES.least_ns
    if max(stamps) > MAX_STAMP_NS or not SAMPLES.least_ns <= interval <= SAMPLES.most_ns:
        return None
    return make_samples(stamps, values * layout.factors, 0)


def _one_by_one(table: Path, lines: list[str], layout: _Layout) -> ImuSamples:
    """Samples of the lines that are well-formed."""
    stamps, values = [], []
    for number, text in enumerate(lines, start=1):
        fields = split_fields(text)
        try:
            row = [float(fields[column]) for column in layout.values]
            is_time = 0.0 <= float(fields[layout.stamp]) <= MAX_STAMP_NS
        except (ValueError, IndexError):
            continue
        if is_time:
            stamps.append(StampText(f"{table}:{number}", fields[layout.stamp]))
            values.append([value * by for value, by in zip(row, layout.factors, strict=True)])
    known = {"sec": "s", "nanoseconds": "ns", "nsec": "ns", "usec": "us", "msec": "ms"}
    named = known.get(layout.unit, layout.unit)
    unit = next((unit for unit in NS_PER_UNIT if unit == named), None)
    stamps_ns = _parse(stamps, unit) if stamps else []
    return make_samples(stamps_ns, values, len(lines) - len(stamps))


def _parse(stamps: Sequence[StampText], unit: StampUnit | None) -> list[int]:
    """Stamps of the stated unit, or else of the one that fits the rate, nanoseconds first."""
    if unit is not None:
        return parse_stamps(stamps, unit, spacing=STATED)
    return parse_stamps(stamps, "ns", spacing=SAMPLES)
