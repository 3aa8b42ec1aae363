"""Plot of an evaluation: the path from above, and the errors over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vo.base.errors import OutputError
from vo.base.extras import require
from vo.base.files.complete_file import writing
from vo.base.printable import printable
from vo.base.types import Floats, Trajectory
from vo.outputs.evaluation.evaluation import Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, safe for colour-blind readers.
_TRUTH, _ESTIMATE, _ROTATION, _FAINT = "#333333", "#0072B2", "#D55E00", "#BBBBBB"
_SUFFIXES = (".png", ".pdf", ".svg")
_GAP = 3.0  # time between two poses, relative to the median, over which no line is drawn
_ALIGNED = {
    "none": "not aligned",
    "se3": "aligned in SE(3)",
    "sim3": "aligned in Sim(3)",
    "scale": "scale aligned",
}


def save_plot(
    path: Path | str, evaluation: Evaluation, reference: Trajectory, title: str = ""
) -> None:
    """Save the plot of an evaluation as a .png, .pdf or .svg file.

    `path`: the file; overwritten if it exists. `reference`: the whole reference; unmatched parts
    are drawn in grey.

    Raises:
        OutputError: unsupported suffix, or the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise OutputError(f"{path}: unsupported kind of plot; use {', '.join(_SUFFIXES)}")
    figure = draw(evaluation, reference, title)
    with writing(path):
        figure.savefig(path)


def draw(evaluation: Evaluation, reference: Trajectory, title: str = "") -> Figure:
    """Draw the plot as a figure without a window.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    require("matplotlib", extra="report", what="plots")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 6.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    figure.suptitle(printable(title), fontsize=12, parse_math=False)
    _draw_path(figure.add_subplot(grid[:, 0]), evaluation, reference)
    upper = figure.add_subplot(grid[0, 1])
    lower = figure.add_subplot(grid[1, 1], sharex=upper)
    seconds = evaluation.matched.seconds
    ate = evaluation.ate
    _draw_errors(upper, seconds, ate.translation_m, "position error", "m", _ESTIMATE)
    if evaluation.alignment.kind in ("se3", "sim3"):
        angles, name = evaluation.rotation_alone_deg, "rotation-alone error"
    else:
        angles, name = ate.rotation_deg, "rotation error"
    _draw_errors(lower, seconds, angles, name, "deg", _ROTATION)
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("time since the first matched pose (s)")
    return figure


def _draw_path(axes: Axes, evaluation: Evaluation, reference: Trajectory) -> None:
    seconds = evaluation.matched.seconds
    truth = with_gaps(evaluation.matched.reference[:, :3, 3], seconds)
    estimate = with_gaps(evaluation.aligned[:, :3, 3], seconds)
    across, up = axes_from_above(evaluation.matched.reference)
    whole = reference.positions
    axes.plot(whole[:, across], whole[:, up], color=_FAINT, lw=0.8, zorder=1)
    axes.plot(
        truth[:, across], truth[:, up], "--", color=_TRUTH, lw=1.2, label="ground truth", zorder=3
    )
    label = f"estimate, {_ALIGNED[evaluation.alignment.kind]}"
    axes.plot(estimate[:, across], estimate[:, up], color=_ESTIMATE, lw=2.4, label=label, zorder=2)
    start, end = truth[0, [across, up]], truth[-1, [across, up]]
    axes.plot(*start, "o", color=_TRUTH, ms=7, label="start", zorder=4)
    axes.plot(*end, "s", color="white", mec=_TRUTH, ms=6, label="end", zorder=4)
    axes.set_xlabel(f"{'xyz'[across]} (m)")
    axes.set_ylabel(f"{'xyz'[up]} (m)")
    axes.set_title("path from above", loc="left", fontsize=10)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.legend(frameon=False, fontsize=9, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.04))
    _tidy(axes)


def _draw_errors(
    axes: Axes, seconds: Floats, errors: Floats, name: str, unit: str, colour: str
) -> None:
    rmse = float(np.sqrt(np.mean(errors**2)))
    drawn, at = with_gaps(errors, seconds), with_gaps(seconds, seconds)
    axes.plot(at, drawn, color=colour, lw=1.4)
    axes.fill_between(at, drawn, color=colour, alpha=0.12, lw=0)
    axes.axhline(rmse, color=_TRUTH, lw=0.9, ls=":")
    numbers = f"rmse {rmse:.3g} {unit} (dotted), max {errors.max():.3g} {unit}"
    axes.set_title(f"{name}: {numbers}", loc="left", fontsize=10)
    axes.set_ylabel(f"{name} ({unit})")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    _tidy(axes)


def with_gaps(values: Floats, seconds: Floats) -> Floats:
    """Values (N, ...) at increasing times (N,), with a row of NaN where poses are missing."""
    steps = np.diff(seconds)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1 if len(steps) else steps.astype(int)
    return np.insert(values, gaps, np.nan, axis=0)


def _tidy(axes: Axes) -> None:
    axes.grid(True, color="#E6E6E6", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def axes_from_above(world_from_cam: Floats) -> tuple[int, int]:
    """Horizontal world axes (0, 1, 2 for x, y, z) to plot rightwards and upwards, seen from above.

    Cameras are mostly held upright, so the world axis nearest to their mean y axis is taken as the
    vertical. The order of the other two is chosen so that the path is not mirrored.
    """
    down = world_from_cam[:, :3, 1].mean(axis=0)
    vertical = int(np.argmax(np.abs(down)))
    first, second = (vertical + 1) % 3, (vertical + 2) % 3
    return (first, second) if down[vertical] < 0 else (second, first)
