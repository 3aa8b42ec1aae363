"""Smooth camera paths: uniform cubic B-splines, twice continuously differentiable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.types import Floats

# Basis of the uniform cubic B-spline; rows are powers 1, s, s², s³ of the share between knots.
_BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0

_LAP_S = 8.0
_KNOTS_PER_LAP = 8


@dataclass(frozen=True, eq=False)
class Path:
    """A closed path of cam0.

    Attributes:
        controls: (K, 6) control values of x, y, z in metres and yaw, pitch, roll in radians; the
            camera looks along (cos yaw cos pitch, sin yaw cos pitch, sin pitch), z is up.
        turns: how often yaw goes round from start to end.
        duration_s: time from start to start.
    """

    controls: Floats
    turns: int
    duration_s: float

    def world_from_cam0(self, time_s: Floats) -> Floats:
        """Poses (N, 4, 4) at times (N,), which wrap around."""
        values = self._values(time_s)
        poses = np.zeros((len(values), 4, 4))
        poses[:, :3, :3] = _rotations(values[:, 3], values[:, 4], values[:, 5])
        poses[:, :3, 3] = values[:, :3]
        poses[:, 3, 3] = 1.0
        return poses

    def _values(self, time_s: Floats) -> Floats:
        count = len(self.controls)
        knots = np.asarray(time_s, dtype=np.float64) * count / self.duration_s
        first = np.floor(knots).astype(np.int64)
        share = knots - first
        index = first[:, None] + np.arange(4)
        local = self.controls[index % count].copy()
        local[..., 3] += 2 * np.pi * self.turns * (index // count)  # yaw does not jump at the seam
        powers = share[:, None] ** np.arange(4)
        return np.asarray(np.einsum("np,pk,nkc->nc", powers, _BASIS, local))


def walk_around(seed: int, duration_s: float) -> Path:
    """Walk counter-clockwise around the origin, looking ahead and outward, back to the start.

    One lap of about 9 m takes about 8 s; longer walks take more laps, each a little different, and
    shorter ones do not come round.
    """
    rng = np.random.default_rng([seed, 1])
    laps = max(1, round(duration_s / _LAP_S))
    count = laps * _KNOTS_PER_LAP
    around = 2 * np.pi * np.arange(count) / _KNOTS_PER_LAP
    scale = 1.0 + rng.uniform(-0.07, 0.07, count)
    controls = np.column_stack(
        [
            1.85 * scale * np.cos(around),
            1.35 * scale * np.sin(around),
            1.45 + rng.uniform(-0.18, 0.18, count),
            around + np.deg2rad(65.0) + rng.uniform(-0.14, 0.14, count),
            np.deg2rad(-7.0) + rng.uniform(-0.09, 0.09, count),
            rng.uniform(-0.05, 0.05, count),
        ]
    )
    return Path(controls, laps, max(duration_s, _LAP_S))


def _rotations(yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    """Columns are the camera's right, down and forward in the world."""
    zero = np.zeros_like(yaw)
    forward = [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)]
    level = np.stack([np.sin(yaw), -np.cos(yaw), zero], axis=-1)
    ahead = np.stack(forward, axis=-1)
    below = np.cross(ahead, level)
    cosine, sine = np.cos(roll)[:, None], np.sin(roll)[:, None]
    right, down = cosine * level + sine * below, cosine * below - sine * level
    return np.stack([right, down, ahead], axis=-1)
