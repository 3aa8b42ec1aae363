"""Markers that were moved during a run: their places by parts of their views differ."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats
from vo.engine.markers.marker_problem import MarkerProblem, MarkerView
from vo.tools.markers.scale_fit import ScaleFit, fit_scale

_MAX_GAP_NS = 250_000_000  # between views of one visit
_MIN_VIEWS, _MAX_VIEWS, _MAX_PARTS = 4, 12, 8  # of a part of the views; parts of a marker
_SIGMAS = 4.0
_MAX_DRIFT = 1.0  # of the path, times 1 % of its length: more is no error of odometry
# Errors of the path, of its length between two parts and of the distance of the marker, that the
# covariance of their places lacks.
_PATH_RATIO, _DISTANCE_RATIO = 0.01, 0.003
# RMS error of the corners of a marker that moves all the time, in standard deviations: beside
# others, of which it has a multiple, or alone.
_MAX_ERROR, _MAX_RATIO, _MAX_LONE_ERROR = 20.0, 5.0, 50.0
_UNIT_SIGMA = 0.005  # of a metric path


class Moved(NamedTuple):
    """A marker whose place changed between two frames, and the views of one place that are used."""

    id: int
    frames: tuple[int, int]
    apart_m: float
    views: tuple[MarkerView, ...]


def fit_unmoved(
    views: Sequence[MarkerView], world_from_cam0: Floats, along: Floats, *, is_metric: bool
) -> tuple[ScaleFit | None, list[str]]:
    """`fit_scale` without the views of markers that were moved; a sentence names each of them.

    `world_from_cam0` (N, 4, 4) and `along` (N,): pose of the camera at each view, and the length of
    the path before it, in one unit. Where most of several markers would have been moved, the path
    may be wrong: they are used.
    """
    moved, examined = _moved_markers(views, world_from_cam0, along, is_metric=is_metric)
    notes = []
    if len(moved) > max(1, examined // 2):
        names = ", ".join(str(each.id) for each in moved)
        notes = [f"markers {names} are not where the path expects them: it drifts, or they move"]
        moved = []
    notes += [
        f"marker {each.id} was moved by {each.apart_m:.2g} m between frames {each.frames[0]} and "
        f"{each.frames[1]}: "
        + (
            f"only its views in frames {each.views[0].frame_index} to {each.views[-1].frame_index} "
            "are used"
            if each.views
            else "it is left out"
        )
        for each in moved
    ]
    kept = {id(view) for each in moved for view in each.views}
    doubted = {each.id for each in moved}
    while True:
        rows = [n for n, view in enumerate(views) if view.id not in doubted or id(view) in kept]
        used = [views[n] for n in rows]
        fit = fit_scale(used, world_from_cam0[rows], is_metric=is_metric) if used else None
        moving = None if fit is None else _moving(fit)
        if moving is None:
            return fit, notes
        notes.append(f"marker {moving} moves while it is in view, or is bent: it is left out")
        doubted.add(moving)
        kept -= {id(view) for view in views if view.id == moving}


def _moving(fit: ScaleFit) -> int | None:
    """The marker whose views contradict each other most, None if all agree."""
    worst = max(fit.markers, key=lambda marker: marker.error)
    others = [marker.error for marker in fit.markers if marker.id != worst.id]
    if not others:
        return worst.id if worst.error > _MAX_LONE_ERROR else None
    limit = max(_MAX_ERROR, _MAX_RATIO * float(np.median(others)))
    return worst.id if worst.error > limit else None


def _moved_markers(
    views: Sequence[MarkerView], world_from_cam0: Floats, along: Floats, *, is_metric: bool
) -> tuple[list[Moved], int]:
    """Markers that stood at more than one place, and the number of those that were examined."""
    moved, examined = [], 0
    for number in sorted({view.id for view in views}):
        rows = [n for n, view in enumerate(views) if view.id == number and not view.is_ambiguous]
        parts = [[rows[n] for n in part] for part in _parts([views[n] for n in rows])]
        if len(parts) > 1:
            found = _examine(views, world_from_cam0, along, parts, is_metric)
            examined += found is not None
            moved += [found] if isinstance(found, Moved) else []
    return moved, examined


def _parts(views: Sequence[MarkerView]) -> list[range]:
    """Consecutive views of one marker, in parts that no gap divides."""
    stamps = np.array([view.stamp_ns for view in views], dtype=np.int64)
    ends = [0, *(np.flatnonzero(np.diff(stamps) > _MAX_GAP_NS) + 1).tolist(), len(views)]
    visits = [range(a, b) for a, b in zip(ends, ends[1:], strict=False) if b - a >= _MIN_VIEWS]
    visits = sorted(sorted(visits, key=len)[-_MAX_PARTS:], key=lambda visit: visit.start)
    each = max(1, _MAX_PARTS // max(len(visits), 1))
    parts = []
    for visit in visits:
        count = min(each, len(visit) // _MIN_VIEWS)
        cuts = np.linspace(visit.start, visit.stop, count + 1).round().astype(int).tolist()
        parts += [range(a, b) for a, b in zip(cuts, cuts[1:], strict=False)]
    return parts


def _examine(
    views: Sequence[MarkerView],
    poses: Floats,
    along: Floats,
    parts: Sequence[Sequence[int]],
    is_metric: bool,
) -> Moved | bool | None:
    """How a marker moved, False if it stood still, None if that cannot be said."""
    sampled = [part[:: -(-len(part) // _MAX_VIEWS)] for part in parts]
    rows = [row for part in sampled for row in part]
    number = [n for n, part in enumerate(sampled) for _ in part]
    marked = [views[row]._replace(id=n) for row, n in zip(rows, number, strict=True)]
    problem = MarkerProblem(
        marked, poses[rows], range(len(parts)), _UNIT_SIGMA if is_metric else None
    )
    start = problem.first_guess(fixed_scale=is_metric)
    solution = None if start is None else problem.solve(start, has_drift=False)
    if solution is None:
        return None
    state, covariance = solution[0], problem.covariance(solution, _MAX_DRIFT)
    middle = [part[len(part) // 2] for part in parts]
    distance = np.linalg.norm(state.positions - poses[middle, :3, 3], axis=1)
    is_new = np.zeros((len(parts), len(parts)), dtype=bool)
    for a in range(len(parts)):
        for b in range(a + 1, len(parts)):
            apart = state.positions[a] - state.positions[b]
            pick = np.zeros((3, len(covariance)))
            pick[:, 6 * a + 3 : 6 * a + 6], pick[:, 6 * b + 3 : 6 * b + 6] = np.eye(3), -np.eye(3)
            path = _PATH_RATIO * abs(along[middle[b]] - along[middle[a]])
            sigma = np.hypot(path, _DISTANCE_RATIO * max(distance[a], distance[b]))
            total = pick @ covariance @ pick.T + sigma**2 * np.eye(3)
            is_new[a, b] = apart @ np.linalg.solve(total, apart) > _SIGMAS**2
    if not is_new.any():
        return False
    a, b = (int(n) for n in np.argwhere(is_new)[np.argmin(np.diff(np.argwhere(is_new)))])
    apart_m = float(np.linalg.norm(state.positions[a] - state.positions[b])) / state.units
    frames = views[parts[a][-1]].frame_index, views[parts[b][0]].frame_index
    return Moved(views[rows[0]].id, frames, apart_m, _longest(views, parts, is_new))


def _longest(
    views: Sequence[MarkerView], parts: Sequence[Sequence[int]], is_new: Floats
) -> tuple[MarkerView, ...]:
    """Views of the longest run of parts at one place that a gap separates from all others."""
    best: list[int] = []
    for a in range(len(parts)):
        for b in range(a + 1, len(parts) + 1):
            run = [row for part in parts[a:b] for row in part]
            if len(run) > len(best) and not is_new[a:b, a:b].any():
                best = run
    return tuple(views[row] for row in best)
