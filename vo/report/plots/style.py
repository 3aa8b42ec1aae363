"""How every figure of a report looks; its colours are also those of the page in the light."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from vo.types import Floats

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID, LOST = "#1f2328", "#656d77", "#d8dce1", "#f6d9c8"
# Okabe and Ito's colours, told apart with every kind of colour vision.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f6000")
DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1, 2)))

WIDTH_IN = 11.0
_MOST_POINTS = 3000
_RC: Any = {
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 11.0,
    "axes.labelsize": 10.0,
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
    "legend.fontsize": 10.0,
    "lines.linewidth": 1.5,
    "lines.solid_joinstyle": "round",
    "path.simplify": True,
    "text.parse_math": False,  # names may hold dollars
    "svg.fonttype": "none",  # text stays text
    "pdf.fonttype": 42,
}


@contextmanager
def drawing() -> Iterator[None]:
    """Everything drawn inside has the report's looks, whatever the user's matplotlibrc says."""
    import matplotlib

    with matplotlib.rc_context(), warnings.catch_warnings():
        # A browser finds letters of all scripts; matplotlib's own font does not have them.
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_RC)
        yield


def new_figure(height_in: float) -> Figure:
    """An empty figure of the page's width, which belongs to no window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def colour(number: int) -> str:
    """Of the run or curve with this number."""
    return SERIES[number % len(SERIES)]


def dash(number: int) -> Any:
    """A second sign beside the colour, for print and for those who see no colours."""
    return DASHES[number % len(DASHES)]


def shade(axes: Axes, stretches: Sequence[tuple[float, float]], label: str = "no pose") -> None:
    """Mark stretches of time behind the curves; the first of them goes into the legend."""
    for number, (begin, end) in enumerate(stretches):
        name = label if number == 0 else "_"
        axes.axvspan(begin, max(end, begin), color=LOST, lw=1.0, zorder=0.5, label=name)


def thin(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """A long curve with fewer points that looks the same: least and largest value of each piece."""
    if len(x) <= _MOST_POINTS:
        return x, y
    pieces = np.array_split(np.arange(len(x)), _MOST_POINTS // 2)
    rows = [sorted((p[np.argmin(y[p])], p[np.argmax(y[p])])) for p in pieces]
    kept = np.unique(np.concatenate(rows))
    return x[kept], y[kept]


def broken(x: Floats, y: Floats, cuts: Floats) -> tuple[Floats, Floats]:
    """A curve of increasing x with a gap before each of these x."""
    rows = np.searchsorted(x, cuts)
    return np.insert(x, rows, np.nan), np.insert(y, rows, np.nan)
