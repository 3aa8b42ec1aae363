"""A path moved by positions and wheels: factors of a pose graph of all its keyframes.

Odometry and accepted loops hold the path together, positions hold it in their frame, and ways of
wheels its lengths. How exact the
positions are, and how much odometry drifts, is estimated from how they differ; what positions say
of themselves counts relative to each other only. Where a path without drift explains the
differences as well, nothing moves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import skew
from vo.base.types import Bools, Floats, Ints
from vo.engine.geometry import sim3
from vo.runs.scaling.path_errors import PathErrors, Rows, Solution, solve
from vo.runs.scaling.path_factors import (
    Fixes,
    Given,
    axis_sigmas,
    pieces_of,
    sigma_of,
    white_sigma,
    without_outliers,
)
from vo.runs.scaling.position_noise import Measured, Noise, estimate_noise

_MIN_FIXES = 10
_GROUPS, _COARSE_GROUPS = 250, 60  # positions; more are averaged
_ROUNDS = 3  # of the linearisation
_EVIDENCE = -3.0  # logarithm of the ratio of likelihoods, above which the path moves
_MAX_MOVED = 0.25  # of the extent of the path: more is no drift
_SIGNIFICANT, _COMPARED = 1.5, 40  # movement, relative to what stays uncertain; poses of it
_REFUSED = 35.0  # squared distance of three numbers, in variances
_USUAL_SQUARED = 2.366  # its median
_TURN_SIGMA, _CLOCK_SIGMA_S = 1.0, 0.05  # rad, of the frame of positions before; of their clock
_UNKNOWN_M = 1e4  # of the frame, without positions
_SLOW_S = 30.0  # where the search begins
_MAX_COVARIANCES = 300


class FusedPath(NamedTuple):
    """A path that positions or wheels have moved.

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


def fuse_path(poses: Floats, fixes: Fixes, given: Given) -> FusedPath | None:
    """Move a path to where odometry, loops, positions and wheels agree best.

    Args:
        poses: (n, 4, 4) keyframes in metres, in the frame of the positions.
        fixes: the positions; without any, wheels alone.
        given: everything else that is known.

    Returns:
        None for too few positions.
    """
    centre = (fixes.xyz if len(fixes.at) else poses[:, :3, 3]).mean(axis=0)
    poses, fixes = poses.copy(), replace(fixes, xyz=fixes.xyz - centre)
    poses[:, :3, 3] -= centre
    used = without_outliers(fixes, fixes.xyz - _positions(poses, fixes))
    fewest = _MIN_FIXES if len(fixes.at) or given.ways is None else 0
    if used.sum() < fewest:
        return None
    fusion = _Fusion(poses, given)
    for _ in range(_ROUNDS):
        piece = pieces_of(fixes.rows(used), fixes.xyz[used] - _positions(fusion.poses, fixes, used))
        is_moved = fusion.learn(fixes.rows(used), piece)
        if not is_moved:
            break
        refused = fusion.refused(fixes.rows(used), piece)
        used[np.flatnonzero(used)[refused]] = False
        if used.sum() < fewest:
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
    jumps = max(len(np.unique(piece)) - 1, 0)
    return FusedPath(moved, from_first, in_frame, used, fusion.noise, jumps, is_moved)


class _Fusion:
    """The path so far, with the errors that were taken out of its steps."""

    def __init__(self, poses: Floats, given: Given) -> None:
        self.poses = poses
        self.noise = Noise(0.0, 0.0, 0.0, ())
        self._given, self._is_metric = given, given.is_metric
        self._steps = np.zeros((len(poses), 7))
        self._motions = sim3.inverse(poses[:-1]) @ poses[1:]
        self._errors = self._errors_of(poses)
        self._solved: tuple[Measured, Solution] | None = None

    def _errors_of(self, poses: Floats) -> PathErrors:
        return PathErrors(poses, is_metric=self._is_metric, joined=self._given.joined)

    def learn(self, fixes: Fixes, piece: Ints) -> bool:
        """Estimate the noise; whether errors of the path show in the positions."""
        measured, _, prior = self._measured(fixes, piece, _COARSE_GROUPS)
        residuals = fixes.xyz - _positions(self.poses, fixes)
        white_m, slow_m = max(white_sigma(residuals), 1e-3), max(sigma_of(residuals), 1e-3)
        given = measured, self._errors, prior, self._given.smallest_m, white_m
        if self.noise.factors:
            self.noise, _ = estimate_noise(*given, self.noise, has_drift=True)
            return True
        usual = (1.0,) * self._errors.kinds
        still, alone = estimate_noise(*given, Noise(white_m, slow_m, _SLOW_S, ()), has_drift=False)
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
        shared = self._of_frame(rows)
        chosen = np.unique(np.linspace(0, len(errors) - 1, _COMPARED).astype(np.int64))
        points = self.poses[chosen, :3, 3]
        by_error = np.concatenate([-skew(points), np.tile(np.eye(3), (len(points), 1, 1))], axis=2)
        by_error = np.concatenate([by_error, points[:, :, None]], axis=2)
        if len(measured.times_s):
            errors[:, :width] += solution.parameters[:width]
        else:  # wheels measure the drift of the scale, and nothing else
            shared = np.zeros_like(shared)
            by_error[:, :, :6], by_error[:, :, 6] = 0.0, 1.0
        (spread,) = self._errors.covariances(rows, self.noise.factors, solution, chosen, [shared])
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
        if size == 0:
            return np.zeros(0, bool)
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
        # Not by the inverses of poses, which would add up their rounding errors in every round.
        self._motions = self._motions @ sim3.retract(change[1:])
        moved = [sim3.retract(turn) @ self.poses[0]]
        for motion in self._motions:
            moved.append(moved[-1] @ motion)
        self.poses = np.stack(moved)
        self._errors = self._errors_of(self.poses)
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
        others = np.unique(piece)
        if count:
            others = others[others != np.bincount(piece).argmax()]
        shifts = (piece[:, None] == others)[:, None, :, None] * np.eye(3)[:, None, :]
        trend = np.concatenate(
            [
                *(along[:, :, :width], fixes.velocity[:, :, None]),
                shifts.reshape(count, 3, 3 * len(others)),
            ],
            axis=2,
        )
        before = self._errors.along(self._steps)
        residual = fixes.xyz - points + np.einsum("mij,mj->mi", along, before[fixes.at])
        group = np.minimum(np.arange(count) * min(most, count) // max(count, 1), most)
        group = np.unique(group * (piece.max(initial=0) + 1) + piece, return_inverse=True)[1]
        weight = 1.0 / fixes.sigma**2
        total = np.bincount(group, weight)

        def mean(values: Floats) -> Floats:
            if count == 0:
                return values
            flat = values.reshape(count, -1) * weight[:, None]
            sums = np.add.reduceat(flat, np.flatnonzero(np.diff(group, prepend=-1)), axis=0)
            return np.asarray((sums / total[:, None]).reshape(-1, *values.shape[1:]))

        size = len(total)
        at = fixes.at[np.searchsorted(group, np.arange(size)) + np.bincount(group) // 2]
        rows = Rows(
            np.repeat(at, 3),
            np.zeros(3 * size, np.int64),
            mean(along).reshape(-1, 7),
            mean(along).reshape(-1, 7),
            mean(trend).reshape(3 * size, trend.shape[2]),
            mean(residual).reshape(-1),
        )
        axes = axis_sigmas(residual)
        prior = np.zeros(trend.shape[2])
        prior[:3], prior[width] = _TURN_SIGMA**-2, _CLOCK_SIGMA_S**-2
        if count == 0:
            prior[3:6] = _UNKNOWN_M**-2
        if not self._is_metric and self._given.scale_sigma is not None:
            prior[6] = self._given.scale_sigma**-2
        rows, of_ways, prior = self._with_ways(rows, before, prior)
        rows, further = self._with_loops(rows)
        measured = Measured(rows, mean(fixes.times_s), 1.0 / total, axes, of_ways, further)
        return measured, group, prior

    def _with_ways(self, rows: Rows, errors: Floats, prior: Floats) -> tuple[Rows, Floats, Floats]:
        """Rows with those of wheels and a parameter of their radius; covariance of their ways.

        `errors`: (n, 7) that were taken out of the path.
        """
        ways = self._given.ways
        if ways is None:
            return rows, np.zeros((0, 0)), prior
        along, before, lengths = ways.rows(self.poses)
        taken = (along * errors[ways.at]).sum(axis=1) - (before * errors[ways.since]).sum(axis=1)
        trend = np.zeros((len(lengths), len(prior) + 1))
        trend[:, -1] = lengths
        if not self._is_metric:
            trend[:, 6] = lengths
        alike = np.zeros((len(rows.at), 1))
        joined = Rows(
            np.r_[rows.at, ways.at],
            np.r_[rows.since, ways.since],
            np.concatenate([rows.along, along]),
            np.concatenate([rows.before, before]),
            np.concatenate([np.hstack([rows.trend, alike]), trend]),
            np.r_[rows.residual, ways.way_m - lengths + taken],
        )
        return joined, ways.covariance, np.r_[prior, ways.radius_sigma**-2]

    def _with_loops(self, rows: Rows) -> tuple[Rows, Floats]:
        loops = self._given.loops
        count = len(loops.a)
        further = np.zeros((7 * count, 7 * count))
        if count == 0:
            return rows, further
        for n, each in enumerate(loops.covariance):
            further[7 * n : 7 * n + 7, 7 * n : 7 * n + 7] = each
        in_later = self._errors.inverse_adjoint[loops.b].reshape(-1, 7)
        nothing = np.zeros((7 * count, rows.trend.shape[1]))
        return Rows(
            np.r_[rows.at, np.repeat(loops.b, 7)],
            np.r_[rows.since, np.repeat(loops.a, 7)],
            np.concatenate([rows.along, in_later]),
            np.concatenate([rows.before, in_later]),
            np.concatenate([rows.trend, nothing]),
            np.r_[rows.residual, np.zeros(7 * count)],
        ), further


def _positions(poses: Floats, fixes: Fixes, rows: Bools | slice = slice(None)) -> Floats:
    """(M, 3) of the other sensor, by the path."""
    at = poses[fixes.at[rows]]
    return np.asarray((at[:, :3, :3] @ fixes.in_cam[rows, :, None])[:, :, 0] + at[:, :3, 3])
