"""HTML and SVG of the report page, and how it writes quantities."""

from __future__ import annotations

import html
import io
import json
import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from vo.base.printable import printable
from vo.outputs.report.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Markup(str):
    """Text that is HTML, to be inserted without escaping."""


def element(tag: str, *children: str, **attributes: str) -> Markup:
    """An HTML element; its text is escaped, `Markup` is not; control characters become visible.

    In names of attributes, a trailing underscore is removed (`class_`), others become hyphens.
    """
    formatted = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{html.escape(printable(value), quote=True)}"'
        for name, value in attributes.items()
    )
    return Markup(f"<{tag}{formatted}>{join(*children)}</{tag}>")


def join(*children: str) -> Markup:
    """Pieces one after another; text is escaped."""
    return Markup(
        "".join(c if isinstance(c, Markup) else html.escape(printable(c)) for c in children)
    )


def table(heading: list[str], rows: list[list[str]], **attributes: str) -> Markup:
    """A table whose first column contains row headings; it scrolls if it is too wide."""
    head = element("tr", *(element("th", text, scope="col") for text in heading))
    body = [
        element("tr", element("th", row[0], scope="row"), *(element("td", c) for c in row[1:]))
        for row in rows
    ]
    inside = element("table", element("thead", head), element("tbody", *body), **attributes)
    return element("div", inside, class_="scroll")


COLOURS = {
    style.INK: "ink",
    style.MUTED: "muted",
    style.GRID: "grid",
    style.LOST: "lost",
    **{colour: f"series-{number}" for number, colour in enumerate(style.SERIES)},
}
"""CSS variables of the page, by colours of the figures."""

_PATH = re.compile(r' d="[^"]*"')
_DIGITS = re.compile(r"(\.\d\d)\d+")  # more than a hundredth of a point is not visible
_FAMILY = re.compile(r" ?font-family: [^;\"]*;")
_FONT = re.compile(r"font: ([0-9.]+px) [^;\"]*")
_REFERENCE = re.compile(r'(\bid="|url\(#|href="#)')
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def inline_svg(figure: Figure, prefix: str, caption: str) -> Markup:
    """A figure as an `<svg>` element.

    `figure`: drawn inside `style.drawing`. `prefix`: prefix of its ids, unique in the page.
    `caption`: text for screen readers.
    """
    import matplotlib

    curves = _name_curves(figure)
    stream = io.StringIO()
    with style.drawing(), matplotlib.rc_context({"svg.hashsalt": prefix}):
        figure.savefig(stream, format="svg", transparent=True, metadata=_NO_METADATA)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    head, rest = text.split(">", 1)
    view_box = re.search(r'viewBox="([^"]+)"', head)
    assert view_box is not None
    rest = re.sub(r"<metadata>.*?</metadata>", "", rest, flags=re.DOTALL)
    rest = _REFERENCE.sub(lambda match: f"{match[1]}{prefix}-", rest)
    rest = _PATH.sub(lambda match: _DIGITS.sub(r"\1", match[0]), rest)
    rest = _FONT.sub(lambda match: f"font-size: {match[1]}", rest)
    rest = _FAMILY.sub("", rest)
    for colour, name in COLOURS.items():
        rest = rest.replace(colour, f"var(--{name})")
    inside = rest[: rest.rindex("</svg>")]
    attributes = f'viewBox="{view_box[1]}" role="img" xmlns:xlink="http://www.w3.org/1999/xlink"'
    width, height = (float(value) for value in view_box[1].split()[2:])
    known = [_hover(axes, names, width, height) for axes, names in curves if names]
    if known:
        attributes += f' data-prefix="{prefix}" data-curves="{html.escape(json.dumps(known))}"'
    title = element("title", caption)
    return Markup(f"<svg {attributes}>{title}{inside}</svg>")


def _name_curves(figure: Figure) -> list[tuple[Axes, list[list[str]]]]:
    """Give each curve over an increasing abscissa an id: axes, and id and label of each."""
    found = []
    for number, axes in enumerate(figure.axes):
        names = []
        for row, line in enumerate(axes.lines):
            x = np.asarray(line.get_xdata(), dtype=np.float64)
            steps = np.diff(x[np.isfinite(x)])
            if len(steps) > 2 and (steps >= 0).all() and line.get_transform() == axes.transData:
                line.set_gid(f"curve-{number}-{row}")
                label = str(line.get_label())
                names.append([str(line.get_gid()), "" if label.startswith("_") else label])
        found.append((axes, names))
    return found


def _hover(axes: Axes, names: list[list[str]], width: float, height: float) -> dict[str, Any]:
    """What a script needs to read values off the curves of a drawn figure."""
    box = axes.get_position()
    shared = axes.get_shared_x_axes().get_siblings(axes)
    label = next((each.get_xlabel() for each in shared if each.get_xlabel()), "")
    edges = [box.x0 * width, (1.0 - box.y1) * height, box.width * width, box.height * height]
    return {
        "box": [round(float(value), 2) for value in edges],
        "x": [float(value) for value in axes.get_xlim()],
        "y": [float(value) for value in axes.get_ylim()],
        "log": axes.get_xscale() == "log",
        "labels": [label, axes.get_ylabel()],
        "curves": [[name, printable(text)] for name, text in names],
    }


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
