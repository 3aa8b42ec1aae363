"""The path from above and from the side, with its loops and markers, and its poses over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from vo.base.types import Floats
from vo.outputs.report.plots.style import (
    INK,
    MUTED,
    broken,
    colour,
    dash,
    legend,
    new_figure,
    shade,
    thin,
)
from vo.outputs.report.shown_paths import ShownPath, ShownPaths

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FLAT = 0.12  # height by length below which the side view stretches the height
_MAX_BAND = 700  # points of a band


def draw_above(shown: ShownPaths) -> Figure:
    """The paths from above; of a single run with its loops and markers."""
    figure = new_figure(4.2)
    axes = figure.subplots()
    across, up, *_ = shown.axes
    _draw(axes, shown, across, up, 1.0)
    if len(shown.paths) == 1:
        _draw_places(axes, shown.paths[0], [across, up])
    axes.set_aspect("equal", adjustable="datalim")
    names = shown.names()
    axes.set(title="From above", xlabel=f"{names[across]} ({shown.unit})")
    axes.set(ylabel=f"{names[up]} ({shown.unit})")
    legend(figure, axes)
    return figure


def draw_side(shown: ShownPaths) -> Figure:
    """The paths from the side."""
    figure = new_figure(4.2)
    axes = figure.subplots()
    across, up, vertical, sign = shown.axes
    extent = np.ptp(np.concatenate([path.positions for path in shown.paths]), axis=0)
    along = max((across, up), key=lambda axis: float(extent[axis]))
    _draw(axes, shown, along, vertical, sign)
    is_flat = extent[vertical] < _FLAT * extent[along]
    if not is_flat:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set(title="From the side" + (", height stretched" if is_flat else ""))
    axes.set(xlabel=f"{shown.names()[along]} ({shown.unit})", ylabel=f"height ({shown.unit})")
    legend(figure, axes)
    return figure


def _draw(axes: Axes, shown: ShownPaths, x: int, y: int, flip: float) -> None:
    if shown.truth is not None:
        positions = shown.truth.positions
        axes.plot(positions[:, x], flip * positions[:, y], color=MUTED, lw=3.2, alpha=0.45)
        axes.lines[-1].set_label("ground truth")
    given = shown.given_positions
    if len(given):
        dots = axes.plot(given[:, x], flip * given[:, y], ".", color=colour(4), ms=4)
        dots[0].set_label(given_name(shown))
    for path in shown.paths:
        number = path.entry.number
        positions = np.insert(path.positions, path.cuts, np.nan, axis=0)
        name = path.entry.label if len(shown.paths) > 1 else "estimate"
        style = {"color": colour(number), "ls": dash(number), "label": name}
        axes.plot(positions[:, x], flip * positions[:, y], **style)
    ends = np.array([path.positions[[0, -1]] for path in shown.paths])
    for row, (sign, name) in enumerate((("o", "start"), ("s", "end"))):
        places = ends[:, row]
        style = {"color": INK, "ms": 6 - row, "zorder": 5, "label": name, "ls": ""}
        axes.plot(places[:, x], flip * places[:, y], sign, mfc=INK if not row else "white", **style)
    axes.margins(0.08)


def _draw_places(axes: Axes, path: ShownPath, xy: list[int]) -> None:
    """The path before loops, a line for each loop, relocalisations and markers with their ids."""
    loops, found, markers = places_of(path)
    if len(loops):
        before = path.before_loops()[:, xy]
        axes.plot(*before.T, "--", color=MUTED, lw=1.0, zorder=1.5, label="before loops")
        ends = np.insert(loops, 2, np.nan, axis=1).reshape(-1, 3)[:, xy]
        axes.plot(*ends.T, "-o", color=colour(1), ms=3, lw=0.8, label="loop")
    if len(found):
        axes.plot(*found[:, xy].T, "*", color=INK, ms=11, label="relocalised")
    if markers:
        places = np.array([place for _, place in markers])[:, xy]
        axes.plot(*places.T, "D", color=colour(3), ms=5, label="marker")
        for (text, _), place in zip(markers, places, strict=True):
            axes.annotate(text, place, (5, 4), textcoords="offset points")


def given_name(shown: ShownPaths) -> str:
    """What the positions beside the path are."""
    return "GPS" if shown.is_map else "given positions"


def places_of(path: ShownPath) -> tuple[Floats, Floats, list[tuple[str, Floats]]]:
    """Ends of loops (n, 2, 3), places of relocalisations (m, 3), markers by id."""
    summary = path.entry.run.summary
    loops = [each for each in summary.get("loops", ()) if each["kind"] != "session"]
    ends = np.stack([path.at([each[key] for each in loops]) for key in ("frame", "earlier_frame")])
    found = path.at([each["frame"] for each in summary.get("relocalisations", ())])
    markers = [
        (str(marker.id), path.place(marker.segment, np.array([marker.position]))[0])
        for marker in path.entry.run.markers
    ]
    return (
        ends.swapaxes(0, 1)[np.isfinite(ends).all(axis=(0, 2))],
        found[np.isfinite(found).all(axis=1)],
        [each for each in markers if np.isfinite(each[1]).all()],
    )


def draw_positions(shown: ShownPaths) -> Figure:
    """Coordinates over time, with bands of two standard deviations."""
    labels = [f"{name} ({shown.unit})" for name in shown.names()]
    truth = None if shown.truth is None else shown.truth.positions
    return _over_time(
        shown, "Position", labels, [(path.positions, path.sigmas) for path in shown.paths], truth
    )


def draw_angles(shown: ShownPaths) -> Figure:
    """Heading, pitch and roll of the camera over time, with bands of two standard deviations."""
    labels = ["heading (°)", "pitch (°)", "roll (°)"]
    curves = [path.angles(shown.axes) for path in shown.paths]
    return _over_time(shown, "Orientation of the camera", labels, curves, None)


def _over_time(
    shown: ShownPaths,
    title: str,
    labels: Sequence[str],
    curves: Sequence[tuple[Floats, Floats]],
    truth: Floats | None,
) -> Figure:
    figure = new_figure(4.6)
    rows = figure.subplots(3, 1, sharex=True)
    if truth is not None and shown.truth is not None:
        stamps = np.concatenate([path.stamps_ns for path in shown.paths])
        known = shown.truth.stamps_ns
        during = (known >= stamps.min()) & (known <= stamps.max())
        seconds = shown.paths[0].entry.seconds(known[during])
        for axes, values in zip(rows, truth[during].T, strict=True):
            axes.plot(*thin(seconds, values), color=MUTED, lw=3.2, alpha=0.45, label="ground truth")
    for path, (values, sigmas) in zip(shown.paths, curves, strict=True):
        entry, seconds = path.entry, path.entry.seconds(path.stamps_ns)
        name = entry.label if len(shown.paths) > 1 else "estimate"
        style = {"color": colour(entry.number), "ls": dash(entry.number), "label": name}
        for axes, value, sigma in zip(rows, values.T, sigmas.T, strict=True):
            axes.plot(*broken(*thin(seconds, value), seconds[path.cuts]), **style)
            for part in _bands(path, sigma):
                low, high = value[part] - 2.0 * sigma[part], value[part] + 2.0 * sigma[part]
                axes.fill_between(
                    seconds[part], low, high, color=colour(entry.number), alpha=0.22, lw=0
                )
    if len(shown.paths) == 1:
        for axes in rows:
            shade(axes, shown.paths[0].entry.without_pose_s)
    for axes, label in zip(rows, labels, strict=True):
        axes.set(ylabel=label)
        axes.margins(x=0.01)
    rows[0].set(title=f"{title}, ±2σ")
    rows[-1].set(xlabel="time (s)")
    legend(figure, rows[0])
    return figure


def _bands(path: ShownPath, sigma: Floats) -> Iterator[slice]:
    """Rows of each uninterrupted part with known deviations, thinned."""
    bounds = [0, *path.cuts, len(sigma)]
    step = max(len(sigma) // _MAX_BAND, 1)
    for first, end in zip(bounds[:-1], bounds[1:], strict=True):
        known = first + np.flatnonzero(np.isfinite(sigma[first:end]))
        if len(known) > 1:
            yield slice(int(known[0]), int(known[-1]) + 1, step)
