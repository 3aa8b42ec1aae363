"""Numbers as people read them."""

from __future__ import annotations

import math

_SMALLER = ((1.0, "m", 1.0), (1e-2, "cm", 1e2), (0.0, "mm", 1e3))


def number(value: float, digits: int = 3) -> str:
    """With so many significant digits, and no exponent unless it is far from 1."""
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
    for least, name, factor in _SMALLER:
        if abs(value) >= least:
            return f"{number(value * factor)} {name}"
    return f"{number(value)} m"


def length_scale(largest_m: float) -> tuple[float, str]:
    """What to multiply metres by for an axis that goes up to so many, and the unit then."""
    if largest_m < 0.03:
        return 1e3, "mm"
    return (1e2, "cm") if largest_m < 0.5 else (1.0, "m")


def duration(seconds: float) -> str:
    """In s, min or h."""
    if seconds < 120.0:
        return f"{number(seconds)} s"
    if seconds < 7200.0:
        return f"{number(seconds / 60.0)} min"
    return f"{number(seconds / 3600.0)} h"


def share(part: float, whole: float) -> str:
    """In percent; 100 % only if it is all."""
    if not whole:
        return "–"
    percent = 100.0 * part / whole
    return f"{math.floor(percent * 10.0) / 10.0:g} %" if part < whole else "100 %"
