"""Units of stamps in tables: seconds or nanoseconds, unless the rate of images says otherwise."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from typing import Literal, NamedTuple

from vo.base.errors import SourceError
from vo.base.faults import Fault, FaultKind

_log = logging.getLogger(__name__)

StampUnit = Literal["ns", "us", "ms", "s"]

NS_PER_UNIT: dict[StampUnit, int] = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
MAX_STAMP_NS = 2**63 - 1
MIN_INTERVAL_NS, MAX_INTERVAL_NS = 500_000, 10_000_000_000
"""Other intervals between images are implausible for odometry (2,000 Hz, and 0.1 Hz)."""

_USUAL_INTERVAL_NS = (2_000_000, 1_000_000_000)
_NS_PER_S = 1_000_000_000
_MAX_S = 9_000_000_000
_WORDS = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds", "s": "seconds"}
_MIN_DIGITS_NS = 12
_MIN_UNLIKE_SECONDS = Decimal(10) ** 11
"""As seconds, this would be in the year 5138."""


class StampText(NamedTuple):
    """A stamp as written, and its location (`FILE:NUMBER`) for messages."""

    location: str
    text: str


def parse_stamps(
    stamps: Sequence[StampText], unit: StampUnit, faults: list[Fault] | None = None
) -> list[int]:
    """Convert the stamps of images to nanoseconds.

    They have the usual unit of their table, unless images would then be implausibly far apart or
    close together, and the numbers fit another unit; this is reported by a warning. Whole numbers
    with twelve or more digits may be nanoseconds in a table of seconds.

    `faults`: receives another unit.
    """
    values = [_number(stamp) for stamp in stamps]
    are_whole = all(stamp.text.isascii() and stamp.text.isdigit() for stamp in stamps)
    are_long = are_whole and all(len(stamp.text) >= _MIN_DIGITS_NS for stamp in stamps)
    usual: StampUnit = "ns" if are_long else unit
    found = _unit_that_fits(values, usual, are_whole)
    if found not in (unit, usual):
        _report_unit(stamps[0], _interval(values) * NS_PER_UNIT[unit], unit, found, faults)
    return [_nanoseconds(stamp, found) for stamp in stamps]


def _number(stamp: StampText) -> Decimal:
    try:
        value = Decimal(stamp.text)
    except InvalidOperation:
        value = Decimal("NaN")
    return value if value.is_finite() else Decimal(0)  # refused by `_nanoseconds`


def _interval(values: Sequence[Decimal]) -> Decimal:
    """The median interval; 0 for fewer than two."""
    ordered = sorted(values)
    steps = sorted(b - a for a, b in zip(ordered, ordered[1:], strict=False))
    return steps[(len(steps) - 1) // 2] if steps else Decimal(0)


def _unit_that_fits(values: Sequence[Decimal], usual: StampUnit, are_whole: bool) -> StampUnit:
    interval, largest = _interval(values), max(map(abs, values))
    low, high = _USUAL_INTERVAL_NS
    if not interval or MIN_INTERVAL_NS <= interval * NS_PER_UNIT[usual] <= MAX_INTERVAL_NS:
        return usual
    if not are_whole and largest < _MIN_UNLIKE_SECONDS:
        return usual  # slow, but like seconds
    for unit, factor in NS_PER_UNIT.items():
        if low <= interval * factor <= high and largest * factor <= MAX_STAMP_NS:
            return unit
    return usual


def _nanoseconds(stamp: StampText, unit: StampUnit) -> int:
    try:
        if unit == "s":
            value = stamp_ns_from_seconds(stamp.text)
        elif unit == "ns":
            value = parse_ns(stamp.text)
        else:
            value = int((Decimal(stamp.text) * NS_PER_UNIT[unit]).to_integral_value())
    except (ValueError, InvalidOperation) as error:
        raise SourceError(f"{stamp.location}: stamp {error}") from error
    if abs(value) > MAX_STAMP_NS:
        raise SourceError(
            f"{stamp.location}: stamp {stamp.text} is too large for a time in nanoseconds"
        )
    return value


def parse_ns(text: str) -> int:
    """Parse a stamp in integer nanoseconds.

    Raises:
        ValueError: the text is not an integer.
    """
    if not text.isascii() or not text.isdigit():
        raise ValueError(f"'{text}' is not a whole number of nanoseconds")
    return int(text)


def parse_all_ns(texts: Sequence[str]) -> list[int]:
    """Parse many stamps in integer nanoseconds, faster than one by one.

    Raises:
        ValueError: a text is not an integer.
    """
    digits = "".join(texts)
    if not digits.isascii() or not digits.isdigit():
        raise ValueError("a stamp is not a whole number of nanoseconds")
    return [int(text) for text in texts]


def stamp_ns_from_seconds(text: str) -> int:
    """Convert seconds in decimal notation to nanoseconds, exact to the ninth decimal.

    Raises:
        ValueError: the text is not a number, or too large for 64 bits of nanoseconds.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation as error:
        raise ValueError(f"'{text}' is not a number of seconds") from error
    if not seconds.is_finite() or not -_MAX_S <= seconds <= _MAX_S:
        raise ValueError(f"{text} is out of range for seconds")
    return int((seconds * _NS_PER_S).to_integral_value())


def _report_unit(
    first: StampText,
    interval_ns: Decimal,
    unit: StampUnit,
    found: StampUnit,
    faults: list[Fault] | None,
) -> None:
    interval_s = float(interval_ns) * 1e-9
    _log.warning(
        "%s: as %s, images would be %.3g s apart; the stamps are read as %s",
        first.location.rpartition(":")[0] or first.location,
        _WORDS[unit],
        interval_s,
        _WORDS[found],
    )
    if faults is not None:
        faults.append(Fault(FaultKind.OTHER_STAMP_UNIT, is_handled=True, value=interval_s))
