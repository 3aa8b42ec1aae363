"""The path from above and from the side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Floats
from vo.outputs.evaluation.plots import axes_from_above
from vo.outputs.report.entry import Entry, gaps
from vo.outputs.report.plots.style import INK, MUTED, colour, dash, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FLAT = 0.12  # height by length below which the side view stretches the height


def draw_paths(entries: Sequence[Entry]) -> Figure | None:
    """Paths aligned with the ground truth if there is one; None without a path."""
    entries = [entry for entry in entries if len(entry.run.trajectory)]
    if not entries:
        return None
    evaluated = [entry for entry in entries if entry.evaluation is not None]
    world = _world(evaluated[0] if evaluated else entries[0])
    across, up = axes_from_above(world)
    vertical = 3 - across - up
    sign = -1.0 if world[:, vertical, 1].mean() > 0 else 1.0  # the camera's y points down
    along = max((across, up), key=lambda axis: float(np.ptp(world[:, axis, 3])))
    figure = new_figure(5.2)
    above, side = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    unit = "m" if evaluated else entries[0].run.unit
    for axes, x, y, flip in ((above, across, up, 1.0), (side, along, vertical, sign)):
        _draw(axes, entries, x, y, flip)
    above.set(
        title="From above", xlabel=f"{'xyz'[across]} ({unit})", ylabel=f"{'xyz'[up]} ({unit})"
    )
    side.set(xlabel=f"{'xyz'[along]} ({unit})", ylabel=f"height ({unit})")
    above.set_aspect("equal", adjustable="datalim")
    is_flat = np.ptp(world[:, vertical, 3]) < _FLAT * np.ptp(world[:, along, 3])
    if not is_flat:
        side.set_aspect("equal", adjustable="datalim")
    side.set_title("From the side" + (", height stretched" if is_flat else ""))
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    return figure


def _world(entry: Entry) -> Floats:
    """Poses (N, 4, 4) that determine the vertical direction."""
    if entry.evaluation is not None:
        return entry.evaluation.matched.reference
    return entry.run.trajectory.world_from_cam


def _draw(axes: Axes, entries: Sequence[Entry], x: int, y: int, flip: float) -> None:
    truth = next((e.truth for e in entries if e.truth is not None and e.evaluation), None)
    if truth is not None:
        positions = truth.positions
        axes.plot(positions[:, x], flip * positions[:, y], color=MUTED, lw=3.2, alpha=0.45)
        axes.lines[-1].set_label("ground truth")
    start = None
    for entry in entries:
        if truth is not None and entry.evaluation is None:
            continue  # in a different world frame
        positions = _positions(entry)
        name = entry.label if len(entries) > 1 else "estimate"
        style = {"color": colour(entry.number), "ls": dash(entry.number), "label": name}
        axes.plot(positions[:, x], flip * positions[:, y], **style)
        if start is None:
            start = positions[np.isfinite(positions).all(axis=1)][0]
    if start is not None:
        axes.plot(start[x], flip * start[y], "o", color=INK, ms=6, zorder=5, label="start")
    axes.margins(0.08)


def _positions(entry: Entry) -> Floats:
    """Positions (N, 3), with rows of NaN at gaps and where the world changes."""
    if entry.evaluation is not None:
        every = (entry.evaluation, *entry.others)
        stamps = np.concatenate([each.matched.stamps_ns for each in every])
        order = np.argsort(stamps)
        positions = np.concatenate([each.aligned[:, :3, 3] for each in every])[order]
        stamps = stamps[order]
    else:
        positions, stamps = entry.run.trajectory.positions, entry.run.trajectory.stamps_ns
    cuts = {*gaps(stamps), *(np.flatnonzero(np.diff(entry.run.segment_of(stamps))) + 1).tolist()}
    return np.insert(positions, sorted(cuts), np.nan, axis=0)
