"""Wall time of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Floats
from vo.outputs.report.entry import Entry
from vo.outputs.report.plots.style import SERIES, colour, dash, new_figure, thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Stages shown as one; the remaining time is `other`.
_GROUPS = {
    "read": ("read",),
    "features": ("features",),
    "match": ("match",),
    "align": ("align",),
    "map": ("start", "map"),
    "smooth": ("window", "smooth"),
}
_MAX_BINS = 200


def draw_stages(entry: Entry) -> Figure | None:
    """Wall time by stage of one run: stacked over time, and the means."""
    frames = entry.run.frames
    if frames is None or len(frames) < 2:
        return None
    spent = _grouped(entry)
    bins = np.array_split(np.arange(len(frames)), min(_MAX_BINS, len(frames)))
    seconds = entry.seconds(frames.stamp_ns)
    middle = np.array([seconds[rows].mean() for rows in bins])
    figure = new_figure(3.4)
    over_time, means = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
    layers = [np.array([values[rows].mean() for rows in bins]) for values in spent.values()]
    over_time.stackplot(middle, *layers, colors=SERIES, step="mid", lw=0)
    # Without the first frame, which takes much longer than the others.
    highest = np.percentile(np.sum(layers, axis=0), 98)
    over_time.set_ylim(0.0, 1.3 * highest)
    over_time.margins(x=0.0)
    over_time.set(title="Wall time of a frame by stage", xlabel="time (s)", ylabel="ms")
    _draw_means(means, spent)
    return figure


def _draw_means(axes, spent: dict[str, Floats]) -> None:  # type: ignore[no-untyped-def]
    names = list(spent)
    values = [float(each.mean()) for each in spent.values()]
    bars = axes.barh(names, values, color=SERIES[: len(names)])
    axes.bar_label(bars, labels=[f"{value:.1f}" for value in values], padding=3)
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    axes.margins(x=0.18)
    axes.set(title=f"Mean, in total {sum(values):.1f} ms", xlabel="ms")


def _grouped(entry: Entry) -> dict[str, Floats]:
    frames = entry.run.frames
    assert frames is not None
    nothing = np.zeros(len(frames))
    spent = {
        group: sum((frames.stage_ms.get(stage, nothing) for stage in stages), nothing)
        for group, stages in _GROUPS.items()
    }
    spent["other"] = np.maximum(frames.total_ms - sum(spent.values(), nothing), 0.0)
    return spent


def draw_total_times(entries: Sequence[Entry]) -> Figure | None:
    """Cumulative distribution of the wall time per frame of several runs."""
    runs = [(entry, entry.run.frames) for entry in entries if entry.run.frames is not None]
    if not runs:
        return None
    from matplotlib.ticker import LogFormatter

    figure = new_figure(2.9)
    axes = figure.subplots()
    for entry, frames in runs:
        number = entry.number
        ordered = np.sort(frames.total_ms)
        percentages = 100.0 * np.arange(1, len(ordered) + 1) / len(ordered)
        style = {"color": colour(number), "ls": dash(number), "label": entry.label}
        axes.plot(*thin(ordered, percentages), drawstyle="steps-post", **style)
    axes.set_xscale("log")
    for which in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        which(LogFormatter(minor_thresholds=(1.5, 0.5)))
    axes.set(title="Wall time of a frame", xlabel="ms", ylabel="frames (%)")
    axes.set_ylim(0.0, 102.0)
    figure.legend(loc="outside lower center", ncols=min(len(runs), 4))
    return figure
