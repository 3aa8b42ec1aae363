"""The closed way along which something goes: corners rounded, curvature continuous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.motion.smooth import smoothed_round
from data_synth.motion.spline import bspline
from data_synth.scene.scene import Heights
from vo.errors import ConfigError
from vo.types import Floats

_STEP_M = 0.03
_MOST_STEPS = 40_000
_SHARPEST_RAD = np.deg2rad(175.0)


@dataclass(frozen=True, eq=False)
class Way:
    """A closed curve by its length, a uniform cubic B-spline.

    Attributes:
        controls: (M, 3) controls of x, y and the levelled ground below, metres.
        step_m: length between controls.
    """

    controls: Floats
    step_m: float

    @property
    def length_m(self) -> float:
        """Length of one round."""
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


def make_way(
    waypoints: Floats,
    ground: Heights,
    *,
    cut_m: float,
    weave_m: float,
    weave_length_m: float,
    level_m: float,
    rng: np.random.Generator,
) -> Way:
    """Round the corners of a closed way and let it weave a little.

    It starts in the middle between the first two corners.

    Args:
        waypoints: (K, 2) corners, K >= 2.
        ground: heights below points.
        cut_m: how far inside a corner it may pass.
        weave_m: largest deviation to the sides.
        weave_length_m: usual length of a wave of that deviation.
        level_m: length over which the ground is levelled.
        rng: random numbers for the weaving.

    Raises:
        ConfigError: fewer than two different corners.
    """
    corners = np.asarray(waypoints, dtype=np.float64)
    corners = corners[np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1) > 1e-6]
    if len(corners) < 2:
        raise ConfigError(f"a way needs two different corners or more; got {len(corners)}")
    radii = _radii(corners, cut_m)
    points, step = _resampled(_filleted(corners, radii))
    points = points + _weave(points, step, weave_m, weave_length_m, rng)
    # Arcs end in jumps of curvature; over this length it changes instead.
    smooth_m = float(np.clip(np.median(radii), 0.1, max(0.1, cut_m)))
    points = smoothed_round(points, smooth_m / step)
    points, step = _resampled(points)
    heights = smoothed_round(ground(points)[:, None], level_m / step)
    return Way(np.column_stack([points, heights[:, 0]]), step)


def _radii(corners: Floats, cut_m: float) -> Floats:
    """Radii (K,) of arcs that pass at most `cut_m` inside the corners and fit between them."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    shorter = np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
    half = np.clip(np.abs(_turns(corners)), 1e-6, _SHARPEST_RAD) / 2.0
    by_cut = cut_m / (1.0 / np.cos(half) - 1.0)
    by_length = 0.5 * shorter / np.tan(half)
    return np.asarray(np.minimum(by_cut, by_length))


def _turns(corners: Floats) -> Floats:
    """Angles (K,) by which the way turns left at its corners."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.asarray(np.arctan2(cross, (before * after).sum(axis=1)))


def _filleted(corners: Floats, radii: Floats) -> Floats:
    """Points of the way with arcs for corners, from the middle of its first side."""
    turns = _turns(corners)
    pieces = [0.5 * (corners[0] + corners[1])[None]]
    for i in [*range(1, len(corners)), 0]:
        ahead = corners[i] - corners[i - 1]
        ahead = ahead / np.linalg.norm(ahead)
        left = np.array([-ahead[1], ahead[0]])
        size, side = min(abs(turns[i]), _SHARPEST_RAD), np.sign(turns[i]) or 1.0
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
    count = int(np.clip(np.ceil(along[-1] / _STEP_M), 16, _MOST_STEPS))
    at = np.arange(count) * along[-1] / count
    columns = [np.interp(at, along, column) for column in around.T]
    return np.column_stack(columns), float(along[-1] / count)


def _weave(
    points: Floats, step: float, weave_m: float, weave_length_m: float, rng: np.random.Generator
) -> Floats:
    """Shifts (M, 2) to the sides, of three waves that fit the way's length."""
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12)
    # At a bare corner the side would jump; it turns over the length of a wave instead.
    left = smoothed_round(left, 0.15 * weave_length_m / step)
    usual = len(points) * step / weave_length_m
    shift = np.zeros(len(points))
    for share in (0.6, 1.0, 1.4):
        waves = max(1, round(share * usual))
        phase = float(rng.uniform(0.0, 2.0 * np.pi))
        shift += np.sin(2.0 * np.pi * waves * np.arange(len(points)) / len(points) + phase) / 3.0
    return np.asarray(weave_m * shift[:, None] * left)
