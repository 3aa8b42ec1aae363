"""Style of the figures of a report; the colours are also those of the page in light mode."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from vo.base.extras import require
from vo.base.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID, LOST = "#1f2328", "#656d77", "#d8dce1", "#f6d9c8"
# Okabe and Ito (2008): distinct for all kinds of colour vision.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f6000")
DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1, 2)))

WIDTH_IN = 5.2  # two beside each other on a screen, one on a phone or in a column of a paper
_MAX_POINTS = 3000
_RC: Any = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.linewidth": 1.3,
    "lines.solid_joinstyle": "round",
    "path.simplify": True,
    "text.parse_math": False,  # names may contain dollar signs
    "svg.fonttype": "none",  # text stays text
    "pdf.fonttype": 42,
}


@contextmanager
def drawing() -> Iterator[None]:
    """Apply the style of the report, independently of the user's matplotlibrc.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    require("matplotlib", extra="report", what="reports")
    import matplotlib

    with matplotlib.rc_context(), warnings.catch_warnings():
        # Browsers have glyphs for all scripts, matplotlib's font does not.
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_RC)
        yield


def new_figure(height_in: float) -> Figure:
    """An empty figure of the page's width, without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def colour(number: int) -> str:
    """Colour of the run or curve with this number."""
    return SERIES[number % len(SERIES)]


def dash(number: int) -> Any:
    """Dash pattern of the run or curve with this number, for print and without colour vision."""
    return DASHES[number % len(DASHES)]


def legend(figure: Figure, axes: Axes) -> None:
    """One legend below the figure, if it says more than the axes do."""
    handles, labels = axes.get_legend_handles_labels()
    columns = max(min(60 // max(map(len, labels), default=1), len(labels), 4), 1)
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def shade(axes: Axes, intervals: Sequence[tuple[float, float]], label: str = "no pose") -> None:
    """Shade time intervals behind the curves; the first one is in the legend."""
    for number, (begin, end) in enumerate(intervals):
        name = label if number == 0 else "_"
        axes.axvspan(begin, max(end, begin), color=LOST, lw=1.0, zorder=0.5, label=name)


def thin(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """A long curve with fewer points: the minimum and maximum of each piece."""
    if len(x) <= _MAX_POINTS:
        return x, y
    pieces = np.array_split(np.arange(len(x)), _MAX_POINTS // 2)
    rows = [sorted((p[np.argmin(y[p])], p[np.argmax(y[p])])) for p in pieces]
    kept = np.unique(np.concatenate(rows))
    return x[kept], y[kept]


def broken(x: Floats, y: Floats, cuts: Floats) -> tuple[Floats, Floats]:
    """A curve with increasing x, and a gap before each x in `cuts`."""
    rows = np.searchsorted(x, cuts)
    return np.insert(x, rows, np.nan), np.insert(y, rows, np.nan)
