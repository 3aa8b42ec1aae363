"""Stamps as text, of tables, names of files and trajectories: units, notations, missing zeros."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from typing import Literal, NamedTuple, Protocol, TypeVar

from vo.base.errors import SourceError
from vo.base.faults import Fault, FaultKind
from vo.recordings.formats.warning_kinds import warning_kind

_log = logging.getLogger(__name__)

StampUnit = Literal["ns", "us", "ms", "s"]

NS_PER_UNIT: dict[StampUnit, int] = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
MAX_STAMP_NS = 2**63 - 1
MIN_INTERVAL_NS, MAX_INTERVAL_NS = 500_000, 10_000_000_000
"""Other intervals between images are implausible for odometry (2,000 Hz, and 0.1 Hz)."""

_NS_PER_S = 1_000_000_000
_MAX_S = 9_000_000_000
_MAX_DIGITS = 40
_WORDS = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds", "s": "seconds"}
_MIN_LONG = Decimal(10) ** 11
"""As seconds, this would be in the year 5138; whole numbers of this size may be nanoseconds."""

_Number = TypeVar("_Number", int, Decimal)
_DATE = re.compile(r"(\d{4}-\d\d-\d\d[ T_]\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:\d\d)?")
_PARTS = re.compile(r"(\d+)\.(\d+)")
_JOINED = re.compile(r"(\d{10})(\d{1,9})")
_WIDTHS = (3, 6, 9)  # digits of milli-, micro- and nanoseconds


class Spacing(NamedTuple):
    """Intervals of what has stamps, in nanoseconds.

    Attributes:
        what: the word for it in messages.
        least_ns, most_ns: what is plausible in the usual unit; else another unit is looked for,
            in which the interval lies in `usual_ns`.
    """

    what: str
    least_ns: int
    most_ns: int
    usual_ns: tuple[int, int]


IMAGES = Spacing("images", MIN_INTERVAL_NS, MAX_INTERVAL_NS, (2_000_000, 1_000_000_000))
NAMES = Spacing("images", 2_000_000, 20_000_000_000, (2_000_000, 20_000_000_000))
POSES = Spacing("poses", 200_000, 10_000_000_000_000, (1_000_000, 10_000_000_000))
STATED = Spacing("stamps", 0, MAX_STAMP_NS, (0, 0))  # the unit is known
SAMPLES = Spacing("samples", 20_000, 500_000_000, (500_000, 100_000_000))


class Stamp(Protocol):
    """A stamp of a table."""

    @property
    def location(self) -> str:
        """Where it is, `FILE:NUMBER`, for messages."""
        ...

    @property
    def text(self) -> str:
        """The stamp as written."""
        ...


class StampText(NamedTuple):
    """See `Stamp`."""

    location: str
    text: str


def parse_stamps(
    stamps: Sequence[Stamp],
    unit: StampUnit,
    faults: list[Fault] | None = None,
    spacing: Spacing = IMAGES,
) -> list[int]:
    """Convert stamps to nanoseconds.

    They have the usual unit of their table, unless intervals would then be implausible, and the
    numbers fit another unit; this is reported by a warning. Whole numbers with twelve or more
    digits, with zeros as decimals or an exponent, too, may be nanoseconds in a table of seconds.
    Fractions without leading zeros, as `%d.%d` writes them, are completed, with a warning. Dates
    such as `2011-09-26 13:02:25.964` are taken as UTC.

    `faults`: receives another unit.
    """
    plain = _plain([stamp.text for stamp in stamps], unit, spacing)
    if plain is not None:
        return plain
    if stamps and _DATE.fullmatch(stamps[0].text):
        stamps = [StampText(each.location, _seconds_of_date(each.text)) for each in stamps]
        unit, spacing = "s", STATED
    stamps = _completed(stamps)
    numbers = [_number(stamp.text) for stamp in stamps]
    values = [number or Decimal(0) for number in numbers]
    are_whole = all(value == value.to_integral_value() for value in values)
    are_long = are_whole and all(value >= _MIN_LONG for value in values)
    usual: StampUnit = "ns" if are_long and spacing is not STATED else unit
    has_points = any("." in stamp.text for stamp in stamps)
    found = _unit_that_fits(values, usual, are_whole and not has_points, spacing)
    if found not in (unit, usual) and spacing is not NAMES:
        _report_unit(
            stamps[0], median_interval(values) * NS_PER_UNIT[unit], unit, found, spacing, faults
        )
    parsed = [
        _nanoseconds(stamp, number, found) for stamp, number in zip(stamps, numbers, strict=True)
    ]
    if any("e" in stamp.text.lower() for stamp in stamps) and len(set(parsed)) < len(parsed):
        raise SourceError(
            f"{stamps[0].location}: stamps such as {stamps[0].text} have too few digits to be told "
            "apart; write them with all digits"
        )
    return parsed


def _plain(texts: list[str], unit: StampUnit, spacing: Spacing) -> list[int] | None:
    """Stamps that are nanoseconds for certain, in a fraction of the time; None for others."""
    try:
        values = parse_all_ns(texts)
    except ValueError:
        return None
    is_ns = unit == "ns" or (spacing is not STATED and min(values) >= _MIN_LONG)
    interval = median_interval(values)
    is_usual = not interval or spacing.least_ns <= interval <= spacing.most_ns
    is_certain = is_ns and is_usual and max(values) <= MAX_STAMP_NS
    return values if is_certain and not _may_be_joined(texts) else None


def _seconds_of_date(text: str) -> str:
    """Seconds since 1970, with the decimals as written; what is no date stays as it is."""
    found = _DATE.fullmatch(text)
    try:
        moment = datetime.fromisoformat("" if found is None else found[1] + (found[3] or "Z"))
    except ValueError:
        return text
    assert found is not None
    return f"{int(moment.timestamp())}.{found[2] or 0}"


def _completed(stamps: Sequence[Stamp]) -> Sequence[Stamp]:
    """Stamps with the zeros that `%d.%d` or `%d%d` of seconds and nanoseconds leaves out.

    Then fractions have different lengths, but none begins with a zero; completed, the stamps
    increase in the order of the file, or their intervals differ less.
    """
    texts = [stamp.text for stamp in stamps]
    pattern = _JOINED if _may_be_joined(texts) else _PARTS
    parts = [pattern.fullmatch(text) for text in texts]
    found = [(part[1], part[2]) for part in parts if part is not None]
    digits = [fraction for _, fraction in found]
    width = max(map(len, digits), default=0)
    if (
        len(found) < len(texts)
        or width not in _WIDTHS
        or min(map(len, digits)) == width
        or any(fraction[0] == "0" and len(fraction) > 1 for fraction in digits)
    ):
        return stamps
    completed = [f"{whole}.{fraction:0>{width}}" for whole, fraction in found]
    before, after = [*map(Decimal, texts)], [*map(Decimal, completed)]
    is_ordered = after == sorted(after) and before != sorted(before)
    if not (is_ordered and _irregular(after) <= _irregular(before)) and (
        _irregular(after) >= _irregular(before)
    ):
        return stamps
    shortest = min(range(len(texts)), key=lambda number: len(digits[number]))
    _log.warning(
        "%s: fractions of a second are written without leading zeros; .%s is read as .%s",
        stamps[shortest].location,
        digits[shortest],
        completed[shortest].partition(".")[2],
    )
    return [StampText(stamp.location, text) for stamp, text in zip(stamps, completed, strict=True)]


def _may_be_joined(texts: Sequence[str]) -> bool:
    """Whether the zeros may be left out between seconds and nanoseconds without a point."""
    lengths = set(map(len, texts))
    return len(lengths) > 1 and max(lengths) == 19


def _irregular(values: Sequence[Decimal]) -> int:
    """Number of intervals that differ from the median by more than half of it."""
    ordered, usual = sorted(values), median_interval(values)
    steps = [b - a for a, b in zip(ordered, ordered[1:], strict=False)]
    return sum(abs(step - usual) * 2 > usual for step in steps)


def _number(text: str) -> Decimal | None:
    """The number, or None for what is none, or too large for any time."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    return value if value.is_finite() and value.adjusted() <= _MAX_DIGITS else None


def median_interval(values: Sequence[_Number]) -> _Number | int:
    """The median interval between numbers in order, the lower one of two; 0 for fewer than two."""
    ordered = sorted(values)
    steps = sorted(b - a for a, b in zip(ordered, ordered[1:], strict=False))
    return steps[(len(steps) - 1) // 2] if steps else 0


def _unit_that_fits(
    values: Sequence[Decimal], usual: StampUnit, are_whole: bool, spacing: Spacing
) -> StampUnit:
    interval, largest = median_interval(values), max(map(abs, values))
    low, high = spacing.usual_ns
    fits = spacing.least_ns <= interval * NS_PER_UNIT[usual] <= spacing.most_ns
    if not interval or (fits and largest * NS_PER_UNIT[usual] <= MAX_STAMP_NS):
        return usual
    if usual == "s" and not are_whole and largest < _MIN_LONG:
        return usual  # slow, but like seconds
    for unit, factor in NS_PER_UNIT.items():
        if low <= interval * factor <= high and largest * factor <= MAX_STAMP_NS:
            return unit
    return usual


def _nanoseconds(stamp: Stamp, number: Decimal | None, unit: StampUnit) -> int:
    try:
        if unit == "ns" and (number is None or number != number.to_integral_value()):
            value = parse_ns(stamp.text)
        elif unit == "s" or number is None:
            value = stamp_ns_from_seconds(stamp.text)
        else:
            value = int((number * NS_PER_UNIT[unit]).to_integral_value())
    except ValueError as error:
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
        raise ValueError(f"'{text}' is not a number of seconds or a date") from error
    if not seconds.is_finite() or not -_MAX_S <= seconds <= _MAX_S:
        raise ValueError(f"{text} is out of range for seconds")
    return int((seconds * _NS_PER_S).to_integral_value())


def _report_unit(
    first: Stamp,
    interval_ns: Decimal | int,
    unit: StampUnit,
    found: StampUnit,
    spacing: Spacing,
    faults: list[Fault] | None,
) -> None:
    interval_s = float(interval_ns) * 1e-9
    _log.warning(
        "%s: as %s, %s would be %.3g s apart; the stamps are read as %s",
        first.location.rpartition(":")[0] or first.location,
        _WORDS[unit],
        spacing.what,
        interval_s,
        _WORDS[found],
        extra=warning_kind("fault"),
    )
    if faults is not None:
        faults.append(Fault(FaultKind.OTHER_STAMP_UNIT, is_handled=True, value=interval_s))
