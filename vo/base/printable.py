"""Text from files, made harmless for a terminal and a page."""

from __future__ import annotations

from collections.abc import Iterable

# Control characters can move the cursor, rename the window or send input to the shell; marks of
# writing direction show text in another order than it has.
_CONTROLS = [*range(0x20), *range(0x7F, 0xA0)]
_DIRECTIONS = [0x061C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)]
_REPLACED = {
    **{code: f"\\x{code:02x}" for code in _CONTROLS if chr(code) not in "\t\n"},
    **{code: f"\\u{code:04x}" for code in (*_DIRECTIONS, 0x2028, 0x2029)},
}


def printable(text: str) -> str:
    r"""The text with control characters in Python's notation, such as `\x1b` for escape.

    Ends of lines and tabs stay.
    """
    return text if text.isprintable() else text.translate(_REPLACED)


def spreadsheet_row(values: Iterable[object]) -> list[object]:
    """Values of a table for spreadsheets: text that these would take for a formula has a quote."""
    return [f"'{v}" if isinstance(v, str) and _is_formula(v) else v for v in values]


def _is_formula(text: str) -> bool:
    """Whether a cell with this text is calculated; numbers are no formulas."""
    if not text.lstrip().startswith(("=", "+", "-", "@")):
        return False
    try:
        float(text)
    except ValueError:
        return True
    return False


def counted(number: int, noun: str) -> str:
    """A number and what it counts, such as `1 frame` or `2 frames`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def one_line(text: str) -> str:
    """The text with a single space for each run of white space."""
    return " ".join(text.split())
