"""A path moved by positions of another sensor: factors of a pose graph of all its keyframes.

Odometry and accepted loops hold the path together, positions hold it in their frame. How exact the
positions are, and how much odometry drifts, is estimated from how they differ; what positions say
of themselves counts relative to each other only. Where a path without drift explains the
differences as well, nothing moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import skew
from vo.base.types import Bools, Floats, Ints
from vo.engine.geometry import sim3
from vo.runs.scaling.path_errors import PathErrors, Rows, Solution, solve
from vo.runs.scaling.position_noise import Measured, Noise, estimate_noise

_MIN_FIXES = 10
_GROUPS, _COARSE_GROUPS = 250, 60  # positions; more are averaged
_ROUNDS = 3  # of the linearisation
_EVIDENCE = -3.0  # logarithm of the ratio of likelihoods, above which the path moves
_MAX_MOVED = 0.25  # of the extent of the path: more is no drift
_SIGNIFICANT, _COMPARED = 1.5, 40  # movement, relative to what stays uncertain; poses of it
_NEAR = 20  # positions on each side that an outlier is compared with
_OUTLIER = 5.5  # in standard deviations
_DRIFT = 0.003  # of the path beside it, relative to the way
_REFUSED = 35.0  # squared distance of three numbers, in variances
_USUAL_SQUARED = 2.366  # its median
_JUMP, _JUMP_OF_WAY, _JUMP_SIDE, _MIN_PIECE = 7.0, 0.03, 4, 5
_MAX_PIECES = 12
_MEDIAN = 0.6745  # of the absolute value of a normal number
_TURN_SIGMA, _CLOCK_SIGMA_S = 1.0, 0.05  # rad, of the frame of positions before; of their clock
_SLOW_S = 30.0  # where the search begins
_MAX_COVARIANCES = 300


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


class FusedPath(NamedTuple):
    """A path that positions have moved.

    Attributes:
        poses: (n, 4, 4) similarities, in the frame of the positions.
        from_first: (n, 7, 7) covariances relative to the first pose, in their own frames.
        in_frame: (n, 7, 7) covariances in the frame of the positions.
        used: (M,) positions that are not refused.
        noise: of the positions and of odometry.
        jumps: of the positions.
        is_moved: whether the path had to move; if not, only the frame of the positions changed.
    """

    poses: Floats
    from_first: Floats
    in_frame: Floats
    used: Bools
    noise: Noise
    jumps: int
    is_moved: bool


def fuse_positions(
    poses: Floats,
    fixes: Fixes,
    loops: LoopFactors,
    *,
    is_metric: bool,
    smallest_m: float = 0.0,
) -> FusedPath | None:
    """Move a path to where odometry, loops and positions agree best; None for too few positions.

    Args:
        poses: (n, 4, 4) keyframes in metres, in the frame of the positions.
        fixes: the positions.
        loops: that the path agrees with.
        is_metric: whether the scale of the path cannot drift.
        smallest_m: standard deviation of rounding.
    """
    centre = fixes.xyz.mean(axis=0)
    poses, fixes = poses.copy(), replace(fixes, xyz=fixes.xyz - centre)
    poses[:, :3, 3] -= centre
    used = _without_outliers(fixes, fixes.xyz - _positions(poses, fixes))
    if used.sum() < _MIN_FIXES:
        return None
    fusion = _Fusion(poses, loops, is_metric=is_metric, smallest_m=smallest_m)
    for _ in range(_ROUNDS):
        piece = _pieces(fixes.rows(used), fixes.xyz[used] - _positions(fusion.poses, fixes, used))
        is_moved = fusion.learn(fixes.rows(used), piece)
        if not is_moved:
            break
        refused = fusion.refused(fixes.rows(used), piece)
        used[np.flatnonzero(used)[refused]] = False
        if used.sum() < _MIN_FIXES:
            return None
        piece = piece[~refused]
        fusion.move(fixes.rows(used), piece)
    off = np.linalg.norm((fusion.poses - poses)[:, :3, 3], axis=1)
    extent = float(np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)))
    if not is_moved or np.sqrt((off**2).mean()) > _MAX_MOVED * extent:
        poses[:, :3, 3] += centre
        unknown = np.full((len(poses), 7, 7), np.nan)
        return FusedPath(poses, unknown, unknown, used, fusion.noise, 0, False)
    from_first, in_frame = fusion.covariances()
    moved = fusion.poses.copy()
    moved[:, :3, 3] += centre
    jumps = len(np.unique(piece)) - 1
    return FusedPath(moved, from_first, in_frame, used, fusion.noise, jumps, is_moved)


class _Fusion:
    """The path so far, with the errors that were taken out of its steps."""

    def __init__(
        self, poses: Floats, loops: LoopFactors, *, is_metric: bool, smallest_m: float
    ) -> None:
        self.poses = poses
        self.noise = Noise(0.0, 0.0, 0.0, ())
        self._loops, self._is_metric, self._smallest_m = loops, is_metric, smallest_m
        self._steps = np.zeros((len(poses), 7))
        self._motions = sim3.inverse(poses[:-1]) @ poses[1:]
        self._errors = PathErrors(poses, is_metric=is_metric)
        self._solved: tuple[Measured, Solution] | None = None

    def learn(self, fixes: Fixes, piece: Ints) -> bool:
        """Estimate the noise; whether errors of the path show in the positions."""
        measured, _, prior = self._measured(fixes, piece, _COARSE_GROUPS)
        residuals = fixes.xyz - _positions(self.poses, fixes)
        white_m = max(_white_sigma(residuals), 1e-3)
        given = measured, self._errors, prior, self._smallest_m, white_m
        if self.noise.factors:
            self.noise, _ = estimate_noise(*given, self.noise, has_drift=True)
            return True
        usual = (1.0,) * self._errors.kinds
        still, alone = estimate_noise(
            *given, Noise(white_m, _sigma(residuals), _SLOW_S, ()), has_drift=False
        )
        starts = Noise(white_m, white_m, _SLOW_S, usual), still._replace(factors=usual)
        found = [estimate_noise(*given, each, has_drift=True) for each in starts]
        self.noise, value = max(found, key=lambda each: each[1])
        ratio = self._significance(measured, prior)
        if value - alone > _EVIDENCE and ratio > _SIGNIFICANT:
            return True
        self.noise = still
        return False

    def _significance(self, measured: Measured, prior: Floats) -> float:
        """How far the path would move, relative to how uncertain it would still be."""
        rows, width = measured.rows, self._width
        covariance = measured.covariance(self.noise, self._errors.measured(rows))
        solution = solve(rows, covariance, prior)
        errors = self._errors.expected(rows, self.noise.factors, solution.weighted)
        errors[:, :width] += solution.parameters[:width]
        chosen = np.unique(np.linspace(0, len(errors) - 1, _COMPARED).astype(np.int64))
        points = self.poses[chosen, :3, 3]
        by_error = np.concatenate([-skew(points), np.tile(np.eye(3), (len(points), 1, 1))], axis=2)
        by_error = np.concatenate([by_error, points[:, :, None]], axis=2)
        (spread,) = self._errors.covariances(
            rows, self.noise.factors, solution, chosen, [self._of_frame(rows)]
        )
        left = np.einsum("nij,njk,nik->", by_error, spread, by_error)
        moved = np.einsum("nij,nj->ni", by_error, errors[chosen])
        return float(np.sqrt((moved**2).sum() / max(left, 1e-300)))

    @property
    def _width(self) -> int:
        """Number of the parameters of the frame of the positions."""
        return 6 if self._is_metric else 7

    def _of_frame(self, rows: Rows) -> Floats:
        """(7, P) what the frame of the positions adds to the error of a pose."""
        return np.eye(7, rows.trend.shape[1]) * (np.arange(7)[:, None] < self._width)

    def refused(self, fixes: Fixes, piece: Ints) -> Bools:
        """(M,) positions that contradict all others and the path."""
        measured, group, solution = self._solve(fixes, piece)
        rows = measured.rows
        trend = solution.information @ rows.trend
        precision = solution.information - trend @ solution.covariance @ trend.T
        size = len(measured.times_s)
        blocks = np.stack([precision[3 * g : 3 * g + 3, 3 * g : 3 * g + 3] for g in range(size)])
        weighted = solution.weighted[: 3 * size].reshape(size, 3)
        squared = (weighted * np.linalg.solve(blocks, weighted[:, :, None])[:, :, 0]).sum(axis=1)
        limit = _REFUSED * max(1.0, float(np.median(squared)) / _USUAL_SQUARED)
        return np.asarray(squared[group] > limit)

    def move(self, fixes: Fixes, piece: Ints) -> None:
        """Move the path to the expected errors of its steps."""
        measured, _, solution = self._solve(fixes, piece)
        errors = self._errors.expected(measured.rows, self.noise.factors, solution.weighted)
        change = self._errors.steps(errors) - self._steps
        self._steps += change
        width = self._width
        turn = np.zeros(7)
        turn[:width] = solution.parameters[:width]
        change[0] = 0.0
        moved = [sim3.retract(turn) @ self.poses[0]]
        for motion, step in zip(self._motions, sim3.retract(change[1:]), strict=True):
            moved.append(moved[-1] @ motion @ step)
        self.poses = np.stack(moved)
        self._motions = sim3.inverse(self.poses[:-1]) @ self.poses[1:]
        self._errors = PathErrors(self.poses, is_metric=self._is_metric)
        self._solved = measured, solution

    def covariances(self) -> tuple[Floats, Floats]:
        """Covariances relative to the first pose, and in the frame of the positions."""
        assert self._solved is not None
        measured, solution = self._solved
        count = len(self.poses)
        chosen = np.unique(
            np.linspace(0, count - 1, min(count, _MAX_COVARIANCES)).round().astype(np.int64)
        )
        frame = self._of_frame(measured.rows)
        first = np.zeros_like(frame)
        if not self._is_metric:
            first[3:6, 6], first[6, 6] = -self.poses[0, :3, 3], 1.0
        before = np.clip(np.searchsorted(chosen, np.arange(count), side="right") - 1, 0, None)
        after = np.minimum(before + 1, len(chosen) - 1)
        way = np.maximum(chosen[after] - chosen[before], 1)
        fraction = ((np.arange(count) - chosen[before]) / way)[:, None, None]
        to_own, results = self._errors.inverse_adjoint, []
        for found in self._errors.covariances(
            measured.rows, self.noise.factors, solution, chosen, (first, frame)
        ):
            spread = found[before] + fraction * (found[after] - found[before])
            results.append(to_own @ spread @ np.swapaxes(to_own, 1, 2))
        return results[0], results[1]

    def _solve(self, fixes: Fixes, piece: Ints) -> tuple[Measured, Ints, Solution]:
        measured, group, prior = self._measured(fixes, piece, _GROUPS)
        covariance = measured.covariance(self.noise, self._errors.measured(measured.rows))
        return measured, group, solve(measured.rows, covariance, prior)

    def _measured(self, fixes: Fixes, piece: Ints, most: int) -> tuple[Measured, Ints, Floats]:
        """Groups of positions as rows, the group of each, and what is known of parameters."""
        points = _positions(self.poses, fixes)
        count = len(points)
        along = np.zeros((count, 3, 7))
        along[:, :, :3] = -skew(points)
        along[:, :, 3:6] = np.eye(3)
        along[:, :, 6] = points
        width = self._width
        numbers = np.unique(piece)
        main = np.bincount(piece).argmax()
        others = numbers[numbers != main]
        shifts = (piece[:, None] == others)[:, None, :, None] * np.eye(3)[:, None, :]
        trend = np.concatenate(
            [along[:, :, :width], fixes.velocity[:, :, None], shifts.reshape(count, 3, -1)], axis=2
        )
        before = self._errors.along(self._steps)
        residual = fixes.xyz - points + np.einsum("mij,mj->mi", along, before[fixes.at])
        group = np.minimum(np.arange(count) * min(most, count) // count, most)
        group = np.unique(group * (piece.max() + 1) + piece, return_inverse=True)[1]
        weight = 1.0 / fixes.sigma**2
        total = np.bincount(group, weight)

        def mean(values: Floats) -> Floats:
            flat = values.reshape(count, -1) * weight[:, None]
            sums = np.add.reduceat(flat, np.flatnonzero(np.diff(group, prepend=-1)), axis=0)
            return np.asarray((sums / total[:, None]).reshape(-1, *values.shape[1:]))

        size = len(total)
        at = fixes.at[np.searchsorted(group, np.arange(size)) + np.bincount(group) // 2]
        rows = Rows(
            np.repeat(at, 3),
            np.zeros(3 * size, np.int64),
            mean(along).reshape(-1, 7),
            mean(trend).reshape(3 * size, -1),
            mean(residual).reshape(-1),
        )
        axes = _axis_sigmas(residual)
        rows, further = self._with_loops(rows)
        prior = np.zeros(trend.shape[2])
        prior[:3], prior[width] = _TURN_SIGMA**-2, _CLOCK_SIGMA_S**-2
        return Measured(rows, mean(fixes.times_s), 1.0 / total, axes, further), group, prior

    def _with_loops(self, rows: Rows) -> tuple[Rows, Floats]:
        count = len(self._loops.a)
        further = np.zeros((7 * count, 7 * count))
        if count == 0:
            return rows, further
        for n, each in enumerate(self._loops.covariance):
            further[7 * n : 7 * n + 7, 7 * n : 7 * n + 7] = each
        in_later = self._errors.inverse_adjoint[self._loops.b]
        nothing = np.zeros((7 * count, rows.trend.shape[1]))
        return Rows(
            np.r_[rows.at, np.repeat(self._loops.b, 7)],
            np.r_[rows.since, np.repeat(self._loops.a, 7)],
            np.concatenate([rows.along, in_later.reshape(-1, 7)]),
            np.concatenate([rows.trend, nothing]),
            np.r_[rows.residual, np.zeros(7 * count)],
        ), further


def _positions(poses: Floats, fixes: Fixes, rows: Bools | slice = slice(None)) -> Floats:
    """(M, 3) of the other sensor, by the path."""
    at = poses[fixes.at[rows]]
    return np.asarray((at[:, :3, :3] @ fixes.in_cam[rows, :, None])[:, :, 0] + at[:, :3, 3])


def _white_sigma(residuals: Floats) -> float:
    """Standard deviation along one axis by differences of neighbours."""
    return float(_sigma(np.diff(residuals, axis=0)) / np.sqrt(2.0))


def _sigma(values: Floats) -> float:
    return float(np.median(np.abs(values - np.median(values, axis=0)))) / _MEDIAN


def _axis_sigmas(residual: Floats) -> Floats:
    """(3,) of east, north and up: heights by satellites are less exact."""
    across, up = _white_sigma(residual[:, :2]), _white_sigma(residual[:, 2:])
    ratio = np.clip(up / across, 0.3, 5.0) if across > 0.0 else 1.0
    return np.array([1.0, 1.0, ratio])


def _without_outliers(fixes: Fixes, residuals: Floats) -> Bools:
    """(M,) positions that are near the median of those before and after them."""
    used = np.ones(len(residuals), bool)
    for _ in range(2):
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


def _pieces(fixes: Fixes, residuals: Floats) -> Ints:
    """(M,) number of the part between jumps, by more than the drift between two positions."""
    count = len(residuals)
    steps = np.linalg.norm(np.diff(residuals, axis=0), axis=1)
    way = np.linalg.norm(fixes.velocity[1:], axis=1) * np.diff(fixes.times_s)
    usual = _JUMP * _white_sigma(residuals) * np.sqrt(2.0) + _JUMP_OF_WAY * way
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
