"""The path from above and from the side, with its loops and markers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats, Ints, Trajectory
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
