"""Matches and inliers, the uncertainty of the poses, and wall times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Floats
from vo.outputs.report.entry import Entry
from vo.outputs.report.plots.style import (
    MUTED,
    SERIES,
    broken,
    colour,
    dash,
    legend,
    new_figure,
    shade,
    thin,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_counts(entry: Entry) -> Figure | None:
    """Matches and inliers of the frames of one run, with keyframes as ticks."""
    frames = entry.run.frames
    if frames is None:
        return None
    seconds = entry.seconds(frames.stamp_ns)
    figure = new_figure(3.0)
    axes = figure.subplots()
    for number, (name, counts) in enumerate(
        (("matches", frames.matches), ("inliers", frames.inliers))
    ):
        style = {"color": colour(1 - number), "ls": dash(1 - number), "label": name}
        axes.plot(*thin(seconds, counts.astype(np.float64)), **style)
    keyframes = seconds[frames.keyframe == 1]
    # One line for all ticks: each marker would be an element of the page.
    ticks = np.tile([0.0, 0.05, np.nan], len(keyframes))
    style = {"color": MUTED, "lw": 0.8, "transform": axes.get_xaxis_transform()}
    axes.plot(np.repeat(keyframes, 3), ticks, **style)
    axes.plot([], [], "|", color=MUTED, ms=8, label=f"keyframes ({len(keyframes)})")
    shade(axes, entry.untracked_s, "not tracked")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    axes.set(title="Landmarks of the map found in each image", ylabel="count", xlabel="time (s)")
    legend(figure, axes)
    return figure


def draw_inliers(entries: Sequence[Entry]) -> Figure | None:
    """Inliers of several runs."""
    runs = [(entry, entry.run.frames) for entry in entries if entry.run.frames is not None]
    if not runs:
        return None
    figure = new_figure(2.9)
    axes = figure.subplots()
    for entry, frames in runs:
        number = entry.number
        curve = thin(entry.seconds(frames.stamp_ns), frames.inliers.astype(np.float64))
        axes.plot(*curve, color=colour(number), ls=dash(number), lw=1.2, label=entry.label)
    axes.set(title="Inliers", ylabel="count", xlabel="time (s)")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    legend(figure, axes)
    return figure


def metres_per_unit(entry: Entry) -> float:
    """Factor from the run's lengths to metres, by the alignment with the ground truth."""
    if entry.evaluation is None:
        return 1.0
    return float(entry.evaluation.alignment.reference_from_estimate.scale)


def draw_uncertainty(entries: Sequence[Entry]) -> Figure | None:
    """Standard deviations of keyframe positions and rotations, estimated by the run."""
    runs = [(entry, entry.run.sigmas) for entry in entries if entry.run.sigmas is not None]
    if not runs:
        return None
    figure = new_figure(3.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for entry, sigmas in runs:
        number = entry.number
        seconds = entry.seconds(sigmas.stamp_ns)
        cuts = seconds[np.flatnonzero(np.diff(sigmas.segment)) + 1]
        style = {"color": colour(number), "ls": dash(number), "label": entry.label}
        position = metres_per_unit(entry) * sigmas.position
        for axes, values in ((upper, position), (lower, sigmas.rotation_deg)):
            axes.plot(*broken(seconds, values, cuts), **style)
    if len(runs) == 1:
        for axes in (upper, lower):
            shade(axes, runs[0][0].without_pose_s)
    units = sorted({"m" if entry.evaluation else entry.run.unit for entry, _ in runs})
    upper.set(title="Estimated uncertainty (1σ)", ylabel=f"position ({' or '.join(units)})")
    lower.set(ylabel="rotation (°)", xlabel="time (s)")
    for axes in (upper, lower):
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
    legend(figure, upper)
    return figure


# Stages shown as one; the remaining time is `other`.
_GROUPS = {
    "read": ("read",),
    "features": ("features",),
    "match": ("match",),
    "align": ("align",),
    "map": ("start", "map"),
    "smooth": ("window", "smooth"),
}
_MAX_BINS = 120


def draw_stages(entry: Entry) -> Figure | None:
    """Wall time by stage of one run: stacked over time, and the means."""
    frames = entry.run.frames
    if frames is None or len(frames) < 2:
        return None
    spent = _grouped(entry)
    bins = np.array_split(np.arange(len(frames)), min(_MAX_BINS, len(frames)))
    seconds = entry.seconds(frames.stamp_ns)
    middle = np.array([seconds[rows].mean() for rows in bins])
    figure = new_figure(4.2)
    over_time, means = figure.subplots(2, 1, height_ratios=(1.2, 1.0))
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
    legend(figure, axes)
    return figure
