"""Writes docs/licences.md: the licences of all dependencies, as they declare them."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from dependencies import home_page, licence, required

PATH = Path(__file__).resolve().parent.parent / "docs" / "licences.md"
EXTRAS = (
    *("view", "video", "report", "hdf5", "las", "e57", "ros", "foxglove", "learned", "onnxruntime"),
    *("cluster", "sweep"),
)
_BEGIN, _END = "<!-- begin of the list -->\n", "<!-- end of the list -->\n"


class Row(NamedTuple):
    """A line of the list."""

    package: str
    installed_by: str
    licence: str

    def __str__(self) -> str:
        return f"- {self.package}: {self.licence}"


def rows() -> dict[str, Row]:
    """The lines of the list by distribution: of the core, then of each extra."""
    found: dict[str, Row] = {}
    for extra in ("", *EXTRAS):
        for name in required((extra,) if extra else ()):
            if name not in found:
                origin = f"`{extra}`" if extra else "core"
                page = home_page(name)
                found[name] = Row(f"[{name}]({page})" if page else name, origin, licence(name))
    return found


def main() -> None:
    """Replace the list in the page, with a heading for the core and each extra."""
    before, _, rest = PATH.read_text("utf-8").partition(_BEGIN)
    _, _, after = rest.partition(_END)
    parts = groupby(rows().values(), key=attrgetter("installed_by"))
    sections = ["\n".join([f"### {name}", "", *map(str, lines), ""]) for name, lines in parts]
    text = "\n" + "\n".join(sections) + "\n"
    PATH.write_text(before + _BEGIN + text + _END + after, "utf-8")


if __name__ == "__main__":
    main()
