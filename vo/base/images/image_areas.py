"""Areas of images as text, and the cameras that a text is for.

`10,20,300,40` is a rectangle (x, y, width, height), and six numbers or more are the corners of a
polygon (x1, y1, x2, y2, x3, y3, …), in pixels of the image as recorded. `left:`, `right:` or
`both:` may stand before it; without, the area is one of the left camera.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

_CAMERAS = {"left": (0,), "right": (1,), "both": (0, 1)}
_MAX_COORDINATE = 1e5
_FORM = (
    "give x,y,width,height of a rectangle or x1,y1,x2,y2,x3,y3,… of a polygon, in pixels of the "
    "images as recorded, such as 0,400,1280,80 or right:0,400,1280,80"
)


class ImageArea(NamedTuple):
    """A polygon in the images of some cameras.

    Attributes:
        corners: pixels (u, v), which belong to it.
    """

    text: str
    cameras: tuple[int, ...]
    corners: tuple[tuple[int, int], ...]


def split_cameras(text: str) -> tuple[tuple[int, ...] | None, str]:
    """The cameras that are named before a colon, None without, and the rest of the text."""
    name, colon, rest = text.partition(":")
    cameras = _CAMERAS.get(name.strip().lower()) if colon else None
    return (None, text) if cameras is None else (cameras, rest)


def parse_area(text: str) -> ImageArea:
    """A rectangle or polygon.

    Raises:
        ValueError: the text has another form, or the area has no pixel.
    """
    cameras, numbers = split_cameras(text)
    try:
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        raise ValueError(f"'{text}' is no area; {_FORM}") from None
    if not all(math.isfinite(v) and abs(v) <= _MAX_COORDINATE for v in values):
        raise ValueError(f"'{text}' is no area: its numbers are no pixels; {_FORM}")
    if len(values) == 4:
        corners = _rectangle(text, *values)
    elif len(values) >= 6 and len(values) % 2 == 0:
        corners = tuple(
            (round(u), round(v)) for u, v in zip(values[::2], values[1::2], strict=True)
        )
        if _doubled_area(corners) == 0:
            raise ValueError(f"the polygon '{text}' has no area: its corners are on one line")
    else:
        raise ValueError(f"'{text}' has {len(values)} numbers; {_FORM}")
    return ImageArea(text, (0,) if cameras is None else cameras, corners)


def anchored(text: str, folder: Path) -> str:
    """`[left:|right:|both:]FILE` with a relative path taken from a folder."""
    cameras, path = split_cameras(text)
    prefix = "" if cameras is None else text[: len(text) - len(path)]
    return f"{prefix}{folder / path.strip()}"


def _rectangle(
    text: str, x: float, y: float, width: float, height: float
) -> tuple[tuple[int, int], ...]:
    if width < 1 or height < 1:
        raise ValueError(f"the rectangle '{text}' is {width:g} x {height:g} pixels; {_FORM}")
    left, top, right, bottom = round(x), round(y), round(x + width) - 1, round(y + height) - 1
    return (left, top), (right, top), (right, bottom), (left, bottom)


def _doubled_area(corners: tuple[tuple[int, int], ...]) -> int:
    """Sum of the absolute areas of the triangles at the first corner: 0 if all are on one line."""
    (x0, y0), *others = corners
    pairs = zip(others, others[1:], strict=False)
    return sum(abs((a - x0) * (d - y0) - (b - y0) * (c - x0)) for (a, b), (c, d) in pairs)
