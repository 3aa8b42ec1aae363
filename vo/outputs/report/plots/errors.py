"""Errors against the ground truth: over time, over distance, distributions, by length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from vo.base.types import Floats
from vo.outputs.evaluation.evaluation import Evaluation
from vo.outputs.evaluation.pose_errors import PoseErrors, path_distances
from vo.outputs.report.entry import Entry, gaps
from vo.outputs.report.markup import length_scale
from vo.outputs.report.plots.style import INK, broken, colour, dash, legend, new_figure, shade, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Evaluated = tuple[Entry, Evaluation]


def evaluated(entries: Sequence[Entry]) -> list[Evaluated]:
    """The runs with an evaluation."""
    return [(entry, entry.evaluation) for entry in entries if entry.evaluation is not None]


def draw_errors_over_time(entries: Sequence[Entry]) -> Figure | None:
    """Position and rotation error of each pose; times without a pose are shaded."""
    return _draw_errors(evaluated(entries), "time")


def draw_errors_over_distance(entries: Sequence[Entry]) -> Figure | None:
    """Position and rotation error of each pose over the distance travelled."""
    return _draw_errors(evaluated(entries), "distance")


def _draw_errors(runs: list[Evaluated], by: Literal["time", "distance"]) -> Figure | None:
    if not runs:
        return None
    figure = new_figure(3.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    shown = [(entry, each) for entry, e in runs for each in (e, *entry.others)]
    if by == "distance":
        shown = runs  # the distance between segments is unknown
    factor, unit = _scale([evaluation.ate for _, evaluation in shown])
    for entry, evaluation in shown:
        x = _abscissa(entry, evaluation, by)
        lengths, angles = factor * evaluation.ate.translation_m, rotation_errors(evaluation)
        for axes, errors in ((upper, lengths), (lower, angles)):
            curve = broken(*thin(x, errors), x[gaps(evaluation.matched.stamps_ns)])
            axes.plot(*curve, color=colour(entry.number), ls=dash(entry.number), label=entry.label)
            if evaluation is not entry.evaluation:
                axes.lines[-1].set_label("_")
    if by == "time" and len(runs) == 1:
        for axes in (upper, lower):
            shade(axes, runs[0][0].without_pose_s)
    upper.set(title=f"Error over {by}", ylabel=f"position ({unit})")
    lower.set(ylabel="rotation (°)", xlabel="time (s)" if by == "time" else "travelled (m)")
    for axes in (upper, lower):
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
    legend(figure, upper)
    return figure


def _scale(errors: Sequence[PoseErrors]) -> tuple[float, str]:
    return length_scale(max(float(each.translation_m.max()) for each in errors))


def _abscissa(entry: Entry, evaluation: Evaluation, by: Literal["time", "distance"]) -> Floats:
    if by == "time":
        return entry.seconds(evaluation.matched.stamps_ns)
    return path_distances(evaluation.matched.reference[:, :3, 3])


def rotation_errors(evaluation: Evaluation) -> Floats:
    """Angles (N,) in degrees; the alignment of a straight path leaves its roll undetermined."""
    if evaluation.alignment.kind in ("se3", "sim3"):
        return evaluation.rotation_alone_deg
    return evaluation.ate.rotation_deg


def draw_relative_errors(entries: Sequence[Entry]) -> Figure | None:
    """Cumulative distributions of the relative errors."""
    runs = evaluated(entries)
    rows = [_over_frames(runs), _over_metres(runs)]
    rows = [row for row in rows if row[1]]
    if not rows:
        return None
    figure = new_figure(0.5 + 1.9 * len(rows))
    grid = np.atleast_2d(figure.subplots(len(rows), 2, sharey=True))
    for axes, (title, errors) in zip(grid, rows, strict=True):
        factor, unit = _scale([each for _, each in errors])
        for entry, each in errors:
            number = entry.number
            style = {"color": colour(number), "ls": dash(number), "label": entry.label}
            _cumulative(axes[0], factor * each.translation_m, style)
            _cumulative(axes[1], each.rotation_deg, style)
        axes[0].set(title=title, xlabel=f"error of translation ({unit})", ylabel="steps (%)")
        axes[1].set(xlabel="error of rotation (°)")
    legend(figure, grid[0][0])
    return figure


_Row = tuple[str, list[tuple[Entry, PoseErrors]]]


def _over_frames(runs: Sequence[Evaluated]) -> _Row:
    found = [(entry, e.rpe_frames) for entry, e in runs if e.rpe_frames is not None]
    return "Relative error from pose to pose", found


def _over_metres(runs: Sequence[Evaluated]) -> _Row:
    found = [(entry, e.rpe_metres) for entry, e in runs if e.rpe_metres is not None]
    lengths = sorted({e.delta_m for _, e in runs if e.rpe_metres is not None})
    return f"Relative error over {' or '.join(f'{each:g}' for each in lengths)} m", found


def _cumulative(axes: Axes, errors: Floats, style: dict[str, Any]) -> None:
    ordered = np.sort(errors)
    percentages = 100.0 * np.arange(1, len(ordered) + 1) / len(ordered)
    axes.plot(*thin(ordered, percentages), drawstyle="steps-post", **style)
    axes.plot(np.median(errors), 50.0, "o", color=style["color"], ms=5)
    axes.set(ylim=(0.0, 102.0))
    axes.set_xlim(left=0.0)
    axes.axhline(50.0, color=INK, lw=0.5, ls=":", zorder=1)


def draw_drift(entries: Sequence[Entry]) -> Figure | None:
    """Drift by length of sub-path, as on the KITTI leaderboard; None for a single length."""
    runs = [(entry, e.segments) for entry, e in evaluated(entries) if e.segments is not None]
    if max((len(segments.lengths) for _, segments in runs), default=0) < 2:
        return None
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2)
    for entry, segments in runs:
        number = entry.number
        lengths = [each.length_m for each in segments.lengths]
        style = {"color": colour(number), "ls": dash(number), "marker": "o", "ms": 5}
        translation = [each.translation_percent for each in segments.lengths]
        rotation = [100.0 * each.rotation_deg_per_m for each in segments.lengths]
        left.plot(lengths, translation, label=entry.label, **style)
        right.plot(lengths, rotation, **style)
    left.set(title="Drift by length of sub-path", ylabel="translation (%)")
    right.set(ylabel="rotation (° per 100 m)")
    for axes in (left, right):
        axes.set(xlabel="length (m)")
        axes.set_ylim(0.0, 1.05 * axes.get_ylim()[1])  # whole dots
        axes.set_xlim(0.0, 1.05 * axes.get_xlim()[1])
    legend(figure, left)
    return figure
