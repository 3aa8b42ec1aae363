"""Factors of a path: positions with their outliers and jumps, loops, and ways of wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vo.base.types import Bools, Floats, Ints
from vo.engine.geometry import sim3

_NEAR = 20  # positions on each side that an outlier is compared with
_OUTLIER = 5.5  # in standard deviations
_DRIFT = 0.003  # of the path beside it, relative to the way
_JUMP, _JUMP_OF_WAY, _JUMP_SIDE, _MIN_PIECE = 7.0, 0.03, 4, 5
_MAX_PIECES = 12
_MEDIAN = 0.6745  # of the absolute value of a normal number


@dataclass(frozen=True, eq=False)
class Fixes:
    """M positions of another sensor, in time order, and the keyframes that they belong to.

    Attributes:
        times_s: (M,).
        at: (M,) rows of keyframes.
        in_cam: (M, 3) of the sensor in the frame of that keyframe.
        velocity: (M, 3) in the frame of the positions.
        xyz: (M, 3) measured.
        sigma: (M,) standard deviations, relative to the usual one.
    """

    times_s: Floats
    at: Ints
    in_cam: Floats
    velocity: Floats
    xyz: Floats
    sigma: Floats

    def rows(self, rows: Bools | Ints) -> Fixes:
        """Some of them."""
        return Fixes(*(each[rows] for each in vars(self).values()))


class LoopFactors(NamedTuple):
    """L motions that loops have measured, between keyframes a and b (L,).

    Attributes:
        covariance: (L, 7, 7) in the frame of b.
    """

    a: Ints
    b: Ints
    covariance: Floats


class WayFactors(NamedTuple):
    """W ways that wheels have measured, between keyframes `since` and `at` (W,).

    Attributes:
        way_m: (W,) lengths.
        bend: (W,) length of the path between two keyframes, by that of its chord.
        times_s: (W,).
        variance: (W,) of independent errors.
        radius_sigma: relative standard deviation of an error that all ways have in common.
    """

    at: Ints
    since: Ints
    way_m: Floats
    bend: Floats
    times_s: Floats
    variance: Floats
    radius_sigma: float


class Given(NamedTuple):
    """What is known of a path besides its keyframes and positions.

    Attributes:
        loops: that the path agrees with.
        is_metric: whether the scale of the path cannot drift.
        smallest_m: standard deviation of positions by rounding.
        ways: of wheels, None without any.
        scale_sigma: relative, of the scale of the path; None if only positions and wheels know it.
        joined: (n, 7) further standard deviations of steps, across gaps; None for a path without.
    """

    loops: LoopFactors
    is_metric: bool
    smallest_m: float = 0.0
    ways: WayFactors | None = None
    scale_sigma: float | None = None
    joined: Floats | None = None


def positions_of(poses: Floats, fixes: Fixes) -> Floats:
    """(M, 3) of the other sensor, by the path."""
    at = poses[fixes.at]
    return np.asarray((at[:, :3, :3] @ fixes.in_cam[:, :, None])[:, :, 0] + at[:, :3, 3])


def grouped(poses: Floats, fixes: Fixes, piece: Ints, most: int) -> tuple[Fixes, Ints]:
    """About the `most` means of positions, none across a jump; (M,) the one of each position."""
    count, points = len(fixes.at), positions_of(poses, fixes)
    group = np.arange(count) * min(most, count) // max(count, 1)
    group = np.cumsum((np.diff(group, prepend=0) > 0) | (np.diff(piece, prepend=0) > 0))
    first, weight = np.flatnonzero(np.diff(group, prepend=-1)), fixes.sigma**-2
    values = np.column_stack([fixes.times_s, points, fixes.velocity, fixes.xyz])
    total = np.bincount(group, weight)
    means = np.add.reduceat(values * weight[:, None], first) / total[:, None] if count else values
    times_s, points, velocity, xyz = np.split(means, (1, 4, 7), axis=1)
    at = fixes.at[first + np.bincount(group) // 2]
    in_cam = sim3.inverse(poses[at]) @ np.c_[points, np.ones(len(at))][:, :, None]
    return Fixes(times_s[:, 0], at, in_cam[:, :3, 0], velocity, xyz, 1.0 / np.sqrt(total)), group


def white_sigma(residuals: Floats) -> float:
    """Standard deviation along one axis by differences of neighbours."""
    return float(sigma_of(np.diff(residuals, axis=0)) / np.sqrt(2.0))


def sigma_of(values: Floats) -> float:
    """Standard deviation by the median of absolute differences from the median."""
    if not values.size:
        return 0.0
    return float(np.median(np.abs(values - np.median(values, axis=0)))) / _MEDIAN


def axis_sigmas(residual: Floats) -> Floats:
    """(3,) of east, north and up: heights by satellites are less exact."""
    if not len(residual):
        return np.ones(3)
    across, up = white_sigma(residual[:, :2]), white_sigma(residual[:, 2:])
    ratio = np.clip(up / across, 0.3, 5.0) if across > 0.0 else 1.0
    return np.array([1.0, 1.0, ratio])


def without_outliers(fixes: Fixes, residuals: Floats) -> Bools:
    """(M,) positions that are near the median of those before and after them."""
    used = np.ones(len(residuals), bool)
    for _ in range(2 if len(used) else 0):
        rows = np.flatnonzero(used)
        near = rows[
            np.clip(np.arange(len(rows)) + np.arange(-_NEAR, _NEAR + 1)[:, None], 0, len(rows) - 1)
        ]
        off = residuals[rows] - np.median(residuals[near], axis=0)
        way = np.linalg.norm(fixes.velocity[rows], axis=1) * np.ptp(fixes.times_s[near], axis=0)
        drift = 0.5 * _DRIFT * way[:, None]
        sigma = np.hypot(np.median(np.abs(off), axis=0) / _MEDIAN, drift) + 1e-3
        used[rows[np.linalg.norm(off / sigma, axis=1) > _OUTLIER]] = False
    return used


def pieces_of(fixes: Fixes, residuals: Floats) -> Ints:
    """(M,) number of the part between jumps, by more than the drift between two positions."""
    count = len(residuals)
    if count == 0:
        return np.empty(0, np.int64)
    steps = np.linalg.norm(np.diff(residuals, axis=0), axis=1)
    way = np.linalg.norm(fixes.velocity[1:], axis=1) * np.diff(fixes.times_s)
    usual = _JUMP * white_sigma(residuals) * np.sqrt(2.0) + _JUMP_OF_WAY * way
    jumps: list[int] = []
    for row in np.argsort(usual - steps, kind="stable").tolist()[:50]:
        if steps[row] <= usual[row]:
            break
        before = residuals[max(row + 1 - _JUMP_SIDE, 0) : row + 1]
        after = residuals[row + 1 : row + 1 + _JUMP_SIDE]
        change = np.linalg.norm(np.median(after, axis=0) - np.median(before, axis=0))
        is_near = any(abs(row + 1 - jump) < _MIN_PIECE for jump in (*jumps, 0, count))
        if change > 0.7 * steps[row] and not is_near and len(jumps) < _MAX_PIECES - 1:
            jumps.append(row + 1)
    return np.searchsorted(np.array(sorted(jumps), np.int64), np.arange(count), side="right")
