"""HTML elements with escaped text."""

from __future__ import annotations

import html

from vo.base.printable import printable


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
