"""One scale of a mono path, and the poses of markers in metres, from all views of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import make_transform
from vo.base.types import Floats
from vo.engine.markers.marker_problem import MarkerProblem, MarkerView, Solution

_MIN_VIEWS = 3
_SIZE_SIGMA = 0.003  # of the path itself: its scale drifts after the markers are out of view


class RegisteredMarker(NamedTuple):
    """A marker in a world."""

    id: int
    world_from_marker: Floats  # (4, 4), in metres
    sigma_m: float  # standard deviation of the position, all axes together, given the path
    views: int
    first_frame: int  # number of the first frame that shows it
    last_frame: int
    # RMS distance of its corners from where they are predicted, in units of their standard
    # deviation
    error: float
    sigma_rad: float  # standard deviation of the rotation, all axes together, given the path
    length_m: float


class ScaleFit(NamedTuple):
    """Metres in a unit of the map, its relative standard deviation, and the markers."""

    metres_per_unit: float
    relative_sigma: float
    markers: tuple[RegisteredMarker, ...]


def fit_scale(
    views: Sequence[MarkerView], world_from_cam0: Floats, *, is_metric: bool
) -> ScaleFit | None:
    """The scale and the markers of one world.

    `world_from_cam0`: (N, 4, 4) pose of each, in units of the map. `is_metric`: whether these units
    are metres: the scale is then a check.

    Returns None with too few views of any marker.
    """
    counts = {n: sum(view.id == n for view in views) for n in sorted({view.id for view in views})}
    ids = [number for number, count in counts.items() if count >= _MIN_VIEWS]
    rows = [row for row, view in enumerate(views) if view.id in ids]
    if not rows:
        return None
    problem = MarkerProblem([views[row] for row in rows], world_from_cam0[rows], ids)
    start = problem.first_guess(fixed_scale=is_metric)
    solution = None if start is None else problem.solve(start)
    return None if solution is None else _scale_fit(problem, solution)


def _scale_fit(problem: MarkerProblem, solution: Solution) -> ScaleFit:
    """A solution as the scale and the markers in metres."""
    state, found = solution
    covariance = problem.covariance(solution)
    sigma = float(np.hypot(np.sqrt(covariance[-1, -1]), _SIZE_SIGMA))
    metres = 1.0 / state.units
    markers = []
    for m, number in enumerate(problem.ids):
        rows = np.flatnonzero(problem.marker == m)
        turn, place = slice(6 * m, 6 * m + 3), slice(6 * m + 3, 6 * m + 6)
        sigma_m = metres * float(np.sqrt(np.trace(covariance[place, place])))
        sigma_rad = float(np.sqrt(np.trace(covariance[turn, turn])))
        frames = [problem.views[row].frame_index for row in rows.tolist()]
        pose = make_transform(state.rotations[m], metres * state.positions[m])
        error = float(np.sqrt(np.mean(found.distance[rows] ** 2) / 2.0))
        length_m = problem.views[int(rows[0])].length_m
        counts = (len(rows), frames[0], frames[-1])
        markers.append(RegisteredMarker(number, pose, sigma_m, *counts, error, sigma_rad, length_m))
    return ScaleFit(metres, sigma, tuple(markers))
