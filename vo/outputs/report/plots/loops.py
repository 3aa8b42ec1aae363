"""The path before and after loops, and the places that were seen again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, Ints, Trajectory
from vo.outputs.evaluation.plots import axes_from_above
from vo.outputs.report.entry import Entry, gaps
from vo.outputs.report.plots.style import INK, MUTED, colour, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_loops(entry: Entry) -> Figure | None:
    """The path from above with a line for each loop; None without loops."""
    run = entry.run
    loops = run.summary.get("loops", ())
    if not loops or not len(run.trajectory) or run.frames is None:
        return None
    across, up = axes_from_above(run.trajectory.world_from_cam)
    figure = new_figure(5.2)
    axes = figure.subplots()
    before = _before(entry)
    if before is not None:
        axes.plot(before[:, across], before[:, up], "--", color=MUTED, label="before loops")
    after = _with_gaps(run.trajectory, run.trajectory.positions)
    axes.plot(after[:, across], after[:, up], color=colour(0), label="after loops")
    positions = _Positions(entry)
    ends = [
        positions.of([loop["frame"], loop["earlier_frame"]])
        for loop in loops
        if loop["kind"] != "session"
    ]
    label = "loop"
    for pair in ends:
        axes.plot(pair[:, across], pair[:, up], "-o", color=colour(1), ms=3, lw=0.8, label=label)
        label = "_"
    found = positions.of([each["frame"] for each in run.summary.get("relocalisations", ())])
    if len(found):
        axes.plot(found[:, across], found[:, up], "*", color=INK, ms=11, label="relocalised")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{'xyz'[across]} ({run.unit})", ylabel=f"{'xyz'[up]} ({run.unit})")
    axes.margins(0.08)
    figure.legend(loc="outside lower center", ncols=4)
    return figure


class _Positions:
    """Where frames are in the path."""

    def __init__(self, entry: Entry) -> None:
        assert entry.run.frames is not None
        self._path = entry.run.trajectory
        self._frame, self._stamp_ns = entry.run.frames.frame, entry.run.frames.stamp_ns

    def of(self, numbers: list[int]) -> Floats:
        """(n, 3) by number, NaN for a frame without a pose."""
        result = np.full((len(numbers), 3), np.nan)
        frame = np.clip(np.searchsorted(self._frame, numbers), 0, len(self._frame) - 1)
        stamps = self._stamp_ns[frame]
        row = np.clip(np.searchsorted(self._path.stamps_ns, stamps), 0, len(self._path) - 1)
        known = (self._frame[frame] == numbers) & (self._path.stamps_ns[row] == stamps)
        result[known] = self._path.positions[row[known]]
        return result


def _before(entry: Entry) -> Floats | None:
    """The path before loops, which begins at the same pose; None where it cannot be compared.

    A run in a loaded map is in the world, and in mono the unit, of the map.
    """
    before, after = entry.run.odometry, entry.run.trajectory
    if not len(before) or "map" in entry.run.summary:
        return None
    moved = after.world_from_cam[0] @ inverse(before.world_from_cam[0]) @ before.world_from_cam
    return _with_gaps(before, moved[:, :3, 3])


def _with_gaps(path: Trajectory, positions: Floats) -> Floats:
    rows: list[int] | Ints = gaps(path.stamps_ns)
    return np.insert(positions, rows, np.nan, axis=0)
