"""The 3D view of a report: its data, and the elements that `page.js` fills."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from vo.base.printable import printable
from vo.base.types import Floats, Trajectory
from vo.outputs.report.markup import Markup, element, length
from vo.outputs.report.plots.paths import given_name, places_of
from vo.outputs.report.plots.style import SERIES
from vo.outputs.report.shown_paths import ShownPath, ShownPaths

_MAX_POINTS = 4000  # of a path
_BUTTONS = {
    "3d": "3D",
    "above": "from above",
    "side": "from the side",
    "in": "+",
    "out": "−",
}


def view(shown: ShownPaths) -> Markup:
    """The view; invisible without the script, which hides the figures that it replaces."""
    runs = [_run(path, shown) for path in shown.paths]
    data = {
        "unit": shown.unit,
        "names": _names(shown),
        "isMap": shown.is_map,
        "truth": _truth(shown.truth, shown),
        "given": _given(shown),
        "givenName": given_name(shown),
        "runs": runs,
    }
    colours = [("run", "run")] + [
        (name, label)
        for name, label in (("error", "error"), ("speed", "speed"), ("sigma", "uncertainty"))
        if any(any(value is not None for value in run[name]) for run in runs)
    ]
    first = "error" if len(runs) == 1 and ("error", "error") in colours else "run"
    choices = [
        Markup(f'<option value="{name}"{" selected" * (name == first)}>{label}</option>')
        for name, label in colours
    ]
    buttons = [
        element("button", text, type="button", data_view=name) for name, text in _BUTTONS.items()
    ]
    select = element("label", "colour by ", element("select", *choices))
    canvas = element("canvas", "", role="img", tabindex="0", aria_label=_description(shown))
    # Text of a script is not escaped; JSON needs no "<" outside of strings.
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
    caption = element("figcaption", _caption(shown))
    return element(
        "figure",
        element("div", select, *buttons, class_="tools"),
        element("div", canvas, element("p", "", class_="tip"), class_="stage"),
        element("div", "", class_="key"),
        caption,
        Markup(f'<script type="application/json">{text}</script>'),
        class_="view",
        hidden="hidden",
    )


def _names(shown: ShownPaths) -> list[str]:
    names = shown.names()
    return [names[shown.axes.across], names[shown.axes.up], "up" if shown.is_map else "height"]


def _description(shown: ShownPaths) -> str:
    """The view in words, for readers who don't see it."""
    parts = []
    for path in shown.paths:
        positions = path.positions @ shown.axes.basis.T
        extent = [
            f"{length(float(value), shown.unit)} in {name}"
            for value, name in zip(np.ptp(positions, axis=0), _names(shown), strict=True)
        ]
        apart = float(np.linalg.norm(positions[-1] - positions[0]))
        text = f"{path.entry.name}: extent {', '.join(extent)}; start and end are "
        text += f"{length(apart, shown.unit)} apart"
        if np.isfinite(path.error_m).any():
            text += f"; error {length(float(np.nanmax(path.error_m)))} at most"
        parts.append(text)
    given = len(shown.given_positions)
    if given:
        parts.append(f"beside it {given} positions: {given_name(shown)}")
    return f"Camera path in 3D. {'. '.join(parts)}."


def _caption(shown: ShownPaths) -> str:
    text = "Drag to turn, two fingers or a click and the wheel to zoom, shift and drag to move; "
    text += "arrow keys and + − work, too. Values are shown under the pointer."
    if shown.is_map:
        text += " East, north and up, by the positions that the run was given."
    longest = max(len(path.stamps_ns) for path in shown.paths)
    if longest > _MAX_POINTS:
        text += f" Of {longest} poses, {_MAX_POINTS} are shown: of each group of neighbours the "
        text += "first, and the one with the largest error (without ground truth, the fastest)."
    return text


def _run(path: ShownPath, shown: ShownPaths) -> dict[str, Any]:
    sigma = np.sqrt((path.sigmas**2).sum(axis=1))
    speed = path.speed
    rows = _rows(path.error_m if np.isfinite(path.error_m).any() else speed)
    stamps = path.stamps_ns[rows]
    table = path.entry.run.frames
    frames = (
        np.full(len(rows), -1)
        if table is None or not len(table)
        else _frames(table.stamp_ns, table.frame, stamps)
    )
    cuts = np.searchsorted(rows, path.cuts)
    loops, found, markers = places_of(path)
    return {
        "name": printable(path.entry.label),
        "colour": path.entry.number % len(SERIES),
        "time": _rounded(path.entry.seconds(stamps), 4),
        "frame": frames.tolist(),
        "points": _points(path.positions[rows], shown),
        "error": _rounded(path.error_m[rows], 5),
        "speed": _rounded(speed[rows], 4),
        "sigma": _rounded(sigma[rows], 5),
        "cuts": np.unique(cuts).tolist(),
        "before": _points(path.before_loops() if len(loops) else np.empty((0, 3)), shown),
        "loops": _points(loops.reshape(-1, 3), shown),
        "found": _points(found, shown),
        "markers": [[name, *_points(place[None], shown)] for name, place in markers],
    }


def _rows(values: Floats) -> Any:
    """Rows to show: of each group of neighbours the first, and the one with the largest value."""
    if len(values) <= _MAX_POINTS:
        return np.arange(len(values))
    groups = np.array_split(np.arange(len(values)), _MAX_POINTS // 2)
    known = np.nan_to_num(values, nan=-1.0)
    found = [row for group in groups for row in (group[0], group[np.argmax(known[group])])]
    return np.unique([*found, len(values) - 1])


def _frames(stamps_ns: Any, numbers: Any, wanted_ns: Any) -> Any:
    rows = np.minimum(np.searchsorted(stamps_ns, wanted_ns), len(stamps_ns) - 1)
    return np.where(stamps_ns[rows] == wanted_ns, numbers[rows], -1)


def _truth(truth: Trajectory | None, shown: ShownPaths) -> list[Any]:
    if truth is None:
        return []
    step = -(-len(truth) // _MAX_POINTS)
    return _points(truth.positions[::step], shown)


def _given(shown: ShownPaths) -> list[Any]:
    positions = shown.given_positions
    return _points(positions[:: -(-len(positions) // _MAX_POINTS) or 1], shown)


def _points(positions: Floats, shown: ShownPaths) -> list[Any]:
    """Points as right, ahead and height, one after another; null where the line is interrupted."""
    return _rounded((positions @ shown.axes.basis.T).ravel(), 4)


def _rounded(values: Floats, digits: int) -> list[float | None]:
    return [None if v != v else v for v in np.round(values, digits).tolist()]
