"""Markers and the path that has seen them, from above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Floats
from vo.outputs.evaluation.plots import axes_from_above
from vo.outputs.report.entry import Entry, gaps
from vo.outputs.report.plots.style import INK, colour, dash, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_markers(entry: Entry) -> Figure | None:
    """Each marker with its id, and the path in its world; None without markers."""
    run = entry.run
    if not run.markers or not len(run.trajectory):
        return None
    worlds = sorted({marker.segment for marker in run.markers})
    number = run.segment_of(run.trajectory.stamps_ns)
    of_markers = np.isin(number, worlds)
    if not of_markers.any():
        return None
    across, up = axes_from_above(run.trajectory.world_from_cam[of_markers])
    figure = new_figure(5.2)
    axes = figure.subplots()
    for n, world in enumerate(worlds):
        rows = number == world
        positions = run.trajectory.positions[rows]
        path = np.insert(positions, gaps(run.trajectory.stamps_ns[rows]), np.nan, axis=0)
        style = {"color": colour(n), "ls": dash(n)}
        axes.plot(path[:, across], path[:, up], label=f"path, segment {world}", **style)
    for n, world in enumerate(worlds):
        markers = [marker for marker in run.markers if marker.segment == world]
        places: Floats = np.array([marker.position for marker in markers])
        label = "marker" if n == 0 else "_"
        axes.plot(places[:, across], places[:, up], "s", color=INK, ms=5, label=label)
        for marker, place in zip(markers, places, strict=True):
            at = place[across], place[up]
            axes.annotate(str(marker.id), at, (5, 4), textcoords="offset points")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    axes.margins(0.08)
    figure.legend(loc="outside lower center", ncols=4)
    return figure
