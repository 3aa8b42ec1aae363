"""Closed routes with rounded corners and continuous curvature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_synth.motion.spline import bspline
from data_synth.recipe import LapName
from data_synth.scene.scene import Heights
from vo.base.errors import ConfigError
from vo.base.types import Floats


def smoothed_closed(values: Floats, width: float) -> Floats:
    """Smooth a closed series (M, C): three running means over a third of `width` rows each."""
    box = max(1, round(width / 3.0)) | 1
    for _ in range(3):
        values = _averaged(values, box, "wrap")
    return values


def smoothed(values: Floats, width: float) -> Floats:
    """Smooth an open series (N,) in the same way; its end values are repeated."""
    box = max(1, round(width / 3.0)) | 1
    for _ in range(3):
        values = _averaged(values[:, None], box, "edge")[:, 0]
    return values


def wander(
    rng: np.random.Generator,
    times_s: Floats,
    amplitude: float,
    periods_s: tuple[float, float],
    repeat_s: float | None = None,
) -> Floats:
    """A smooth random series (N,) within ±amplitude, of three waves.

    `rng`: random numbers. `times_s`: (N,). `amplitude`: largest value. `repeat_s`: its period, or
    None for an aperiodic series.
    """
    total = np.zeros(len(times_s))
    for _ in range(3):
        frequency = float(rng.uniform(1.0 / periods_s[1], 1.0 / periods_s[0]))
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        if repeat_s is not None:
            frequency = max(1, round(frequency * repeat_s)) / repeat_s
        total += np.sin(2.0 * np.pi * frequency * times_s + phase)
    return np.asarray(amplitude / 3.0 * total)


def _averaged(values: Floats, box: int, mode: str) -> Floats:
    """Running mean of (M, C) over an odd number of rows, relative to the mean for precision."""
    if box <= 1:
        return values
    middle = values.mean(axis=0)
    reach = box // 2
    index = np.arange(-reach - 1, len(values) + reach)
    index = index % len(values) if mode == "wrap" else np.clip(index, 0, len(values) - 1)
    sums = np.cumsum(values[index] - middle, axis=0)
    return np.asarray(middle + (sums[box:] - sums[:-box]) / box)


def route_of_laps(waypoints: Floats, laps: Sequence[LapName], aside_m: float) -> Floats:
    """The corners (K, 2) of a closed route of several laps, each forward or in reverse.

    Laps change their direction by a U-turn to the left in the middle of the first side, where the
    route starts.

    `waypoints`: (K, 2) corners of one lap. `laps`: directions, one after the other; none for one
    forward lap. `aside_m`: distance of the laps in reverse from the forward ones, to the left of
    these.
    """
    corners = np.asarray(waypoints, dtype=np.float64)
    if not laps:
        return corners
    ahead = _directions(corners)[0]
    left = aside_m * np.array([-ahead[1], ahead[0]])
    middle, past = 0.5 * (corners[0] + corners[1]), 0.5 * aside_m * ahead
    pieces: dict[LapName, Floats] = {
        "forward": np.roll(corners, -1, axis=0),
        "reverse": np.roll(beside(corners, aside_m)[::-1], 1, axis=0),
    }
    u_turns: dict[LapName, Floats] = {
        "forward": np.array([middle + past, middle + past + left]),
        "reverse": np.array([middle - past + left, middle - past]),
    }
    parts = []
    for lap, following in zip(laps, (*laps[1:], laps[0]), strict=True):
        parts.append(pieces[lap])
        if following != lap:
            parts.append(u_turns[lap])
    # A route starts between its first two corners.
    return np.roll(np.concatenate(parts), 1, axis=0)


def _directions(corners: Floats) -> Floats:
    """Directions (K, 2) of the sides, each from a corner to the next."""
    sides = np.roll(corners, -1, axis=0) - corners
    return np.asarray(sides / np.linalg.norm(sides, axis=1, keepdims=True))


def beside(corners: Floats, left_m: float) -> Floats:
    """The corners (K, 2) of a parallel route to the left."""
    ahead = _directions(corners)
    after = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    before = np.roll(after, 1, axis=0)
    along = 1.0 + (before * after).sum(axis=1, keepdims=True)
    return np.asarray(corners + left_m * (before + after) / along)


_STEP_M = 0.03
_MAX_STEPS = 40_000
_MAX_TURN_RAD = np.deg2rad(175.0)


@dataclass(frozen=True, eq=False)
class Route:
    """A closed curve, parametrised by length: a uniform cubic B-spline."""

    controls: Floats  # (M, 3) controls of x, y and the averaged height of the ground, metres
    step_m: float

    @property
    def length_m(self) -> float:
        """Length of one lap."""
        return len(self.controls) * self.step_m

    def at(self, distances_m: Floats, derivative: int = 0) -> Floats:
        """Points (N, 3) at distances from the start, or their derivatives by distance."""
        at = np.asarray(distances_m, dtype=np.float64) / self.step_m
        return bspline(self.controls, at, derivative, np.zeros(3)) / self.step_m**derivative

    def curvatures(self, distances_m: Floats) -> Floats:
        """Curvatures (N,) in space, 1/m, at distances from the start."""
        first, second = self.at(distances_m, 1), self.at(distances_m, 2)
        across = np.linalg.norm(np.cross(first, second), axis=1)
        return np.asarray(across / np.linalg.norm(first, axis=1) ** 3)


def make_route(
    waypoints: Floats,
    ground: Heights,
    *,
    cut_m: float,
    weave_m: float,
    weave_length_m: float,
    level_m: float,
    rng: np.random.Generator,
) -> Route:
    """Round the corners of a closed polygon and let the route weave slightly.

    It starts in the middle between the first two corners.

    `waypoints`: (K, 2) corners, K >= 2. `ground`: heights below points. `cut_m`: largest distance
    by which a corner is cut. `weave_m`: largest deviation to the sides. `weave_length_m`: usual
    wavelength of that deviation. `level_m`: length over which the height of the ground is averaged.
    `rng`: random numbers for the weaving.

    Raises:
        ConfigError: fewer than two different corners.
    """
    corners = np.asarray(waypoints, dtype=np.float64)
    corners = corners[np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1) > 1e-6]
    if len(corners) < 2:
        raise ConfigError(f"a route needs at least two different corners; got {len(corners)}")
    radii = _radii(corners, cut_m)
    points, step = _resampled(_filleted(corners, radii))
    points = points + _weave(points, step, weave_m, weave_length_m, rng)
    # Smooth the jumps of curvature at the ends of arcs over this length.
    smooth_m = float(np.clip(np.median(radii), 0.1, max(0.1, cut_m)))
    points = smoothed_closed(points, smooth_m / step)
    points, step = _resampled(points)
    heights = smoothed_closed(ground(points)[:, None], level_m / step)
    return Route(np.column_stack([points, heights[:, 0]]), step)


def _radii(corners: Floats, cut_m: float) -> Floats:
    """Radii (K,) of arcs that pass at most `cut_m` inside the corners and fit between them."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    shorter = np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
    half = np.clip(np.abs(_turns(corners)), 1e-6, _MAX_TURN_RAD) / 2.0
    by_cut = cut_m / (1.0 / np.cos(half) - 1.0)
    by_length = 0.5 * shorter / np.tan(half)
    return np.asarray(np.minimum(by_cut, by_length))


def _turns(corners: Floats) -> Floats:
    """Angles (K,) of the left turns at the corners."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.asarray(np.arctan2(cross, (before * after).sum(axis=1)))


def _filleted(corners: Floats, radii: Floats) -> Floats:
    """Points of the polygon with arcs for corners, from the middle of the first side."""
    turns = _turns(corners)
    pieces = [0.5 * (corners[0] + corners[1])[None]]
    for i in [*range(1, len(corners)), 0]:
        ahead = corners[i] - corners[i - 1]
        ahead = ahead / np.linalg.norm(ahead)
        left = np.array([-ahead[1], ahead[0]])
        size, side = min(abs(turns[i]), _MAX_TURN_RAD), np.sign(turns[i]) or 1.0
        start = corners[i] - radii[i] * np.tan(size / 2.0) * ahead
        angles = np.linspace(0.0, size, 2 + int(size / 0.02))[:, None]
        arc = np.sin(angles) * ahead + (1.0 - np.cos(angles)) * side * left
        pieces.append(start + radii[i] * arc)
    return np.vstack(pieces)


def _resampled(points: Floats) -> tuple[Floats, float]:
    """Points of a closed curve at equal distances, and that distance."""
    around = np.vstack([points, points[:1]])
    lengths = np.linalg.norm(np.diff(around, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = int(np.clip(np.ceil(along[-1] / _STEP_M), 16, _MAX_STEPS))
    at = np.arange(count) * along[-1] / count
    columns = [np.interp(at, along, column) for column in around.T]
    return np.column_stack(columns), float(along[-1] / count)


def _weave(
    points: Floats, step: float, weave_m: float, weave_length_m: float, rng: np.random.Generator
) -> Floats:
    """Shifts (M, 2) to the sides: three waves, periodic in the length of the route."""
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12)
    # Smooth the direction of the side, which would jump at corners.
    left = smoothed_closed(left, 0.15 * weave_length_m / step)
    usual = len(points) * step / weave_length_m
    shift = np.zeros(len(points))
    for ratio in (0.6, 1.0, 1.4):
        waves = max(1, round(ratio * usual))
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        shift += np.sin(2.0 * np.pi * waves * np.arange(len(points)) / len(points) + phase) / 3.0
    return np.asarray(weave_m * shift[:, None] * left)
