"""Numbers with units as text."""

from __future__ import annotations

import math

_LENGTH_UNITS = ((1.0, "m", 1.0), (1e-2, "cm", 1e2), (0.0, "mm", 1e3))


def number(value: float, digits: int = 3) -> str:
    """A number with this many significant digits, without exponent unless far from 1."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    if not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{decimals}f}".replace("-", "−")


def length(value: float, unit: str = "m") -> str:
    """A length; metres below 1 m are given in cm or mm."""
    if unit != "m":
        return f"{number(value)} {unit}"
    for minimum, name, factor in _LENGTH_UNITS:
        if abs(value) >= minimum:
            return f"{number(value * factor)} {name}"
    return f"{number(value)} m"


def length_scale(largest_m: float) -> tuple[float, str]:
    """Factor from metres to the unit of an axis with this maximum, and the unit."""
    if largest_m < 0.03:
        return 1e3, "mm"
    return (1e2, "cm") if largest_m < 0.5 else (1.0, "m")


def duration(seconds: float) -> str:
    """A duration in s, min or h."""
    if seconds < 120.0:
        return f"{number(seconds)} s"
    if seconds < 7200.0:
        return f"{number(seconds / 60.0)} min"
    return f"{number(seconds / 3600.0)} h"


def percentage(part: float, whole: float) -> str:
    """A ratio in percent, rounded down; 100 % only if `part` equals `whole`."""
    if not whole:
        return "–"
    percent = 100.0 * part / whole
    return f"{math.floor(percent * 10.0) / 10.0:g} %" if part < whole else "100 %"
