"""Closed routes with rounded corners and continuous curvature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.motion.smoothing import smoothed_closed
from data_synth.motion.spline import bspline
from data_synth.scene.scene import Heights
from vo.base.errors import ConfigError
from vo.base.types import Floats

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
