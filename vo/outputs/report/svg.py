"""Figures as inline SVG, with the colours of the page and unique ids."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

from vo.outputs.report.markup import Markup, element
from vo.outputs.report.plots import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {
    style.INK: "ink",
    style.MUTED: "muted",
    style.GRID: "grid",
    style.LOST: "lost",
    **{colour: f"series-{number}" for number, colour in enumerate(style.SERIES)},
}
"""CSS variables of the page, by colours of the figures."""

_FONT = re.compile(r"font: ([0-9.]+px) [^;\"]*")
_REFERENCE = re.compile(r'(\bid="|url\(#|href="#)')
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def inline_svg(figure: Figure, prefix: str, caption: str) -> Markup:
    """A figure as an `<svg>` element.

    `figure`: drawn inside `style.drawing`. `prefix`: prefix of its ids, unique in the page.
    `caption`: text for screen readers.
    """
    import matplotlib

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
    rest = _FONT.sub(lambda match: f"font-size: {match[1]}", rest)
    for colour, name in COLOURS.items():
        rest = rest.replace(colour, f"var(--{name})")
    inside = rest[: rest.rindex("</svg>")]
    attributes = f'viewBox="{view_box[1]}" role="img" xmlns:xlink="http://www.w3.org/1999/xlink"'
    title = element("title", caption)
    return Markup(f"<svg {attributes}>{title}{inside}</svg>")
