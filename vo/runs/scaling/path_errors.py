"""Errors of a path as sums of errors of odometry, and what measurements say about them.

Errors of n poses are left tangents in the frame of the path, relative to the first pose: those of a
pose contain those of all before it. So the covariance of two poses is that of the earlier one, and
measurements at any of them condition all, without a matrix of all poses: a pose graph, solved in
the space of its measurements.

Source: Barfoot, "State Estimation for Robotics", 2017, sec. 3.4 (batch estimation as Gaussian
    process regression), and 7.3 (poses).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats, Ints
from vo.engine.backend.chain_motion import USUAL
from vo.engine.geometry import sim3

_LOG_SCALE_STEP = 0.003  # random, of the logarithm of the scale in mono, for each step
_CHUNK = 100  # poses whose covariances are computed together
_LARGE = 1e18


class Rows(NamedTuple):
    """R scalar measurements: `along` (R, 7) @ error at - `before` (R, 7) @ error since.

    Attributes:
        at: (R,) poses.
        since: (R,) poses, 0 for the first, which has no error.
        trend: (R, P) derivatives by parameters of the measurements.
        residual: (R,) of the path without errors.
    """

    at: Ints
    since: Ints
    along: Floats
    before: Floats
    trend: Floats
    residual: Floats

    @property
    def ends(self) -> tuple[tuple[Ints, Floats], ...]:
        """Poses, and derivatives by their errors."""
        at = self.at, self.along
        return (at, (self.since, -self.before)) if self.since.any() else (at,)


class Solution(NamedTuple):
    """Rows that were solved.

    Attributes:
        information: (R, R) inverse covariance of the measurements.
        weighted: (R,) information @ residuals that the parameters leave.
        parameters: (P,) with their covariance (P, P).
    """

    information: Floats
    weighted: Floats
    parameters: Floats
    covariance: Floats


class PathErrors:
    """What is known of errors of a path before any measurement.

    Args:
        poses: (n, 4, 4) similarities.
        is_metric: whether the scale cannot drift.
        joined: (n, 7) further standard deviations of steps, across gaps; None for a path without.
    """

    def __init__(self, poses: Floats, *, is_metric: bool, joined: Floats | None = None) -> None:
        law = USUAL
        steps = sim3.inverse(poses[:-1]) @ poses[1:]
        length = np.linalg.norm(steps[:, :3, 3], axis=1)
        trace = np.trace(sim3.rigid_part(steps)[:, :3, :3], axis1=1, axis2=2)
        angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
        random, bias = np.zeros((2, len(poses), 7))
        random[1:, :3] = law.step_rad
        random[1:, 3:6] = law.step_ratio * length[:, None]
        bias[1:, :3], bias[1:, 3:6] = (
            law.rotation_ratio * angle[:, None],
            law.ratio * length[:, None],
        )
        scale = np.zeros_like(random)
        scale[1:, 6] = _LOG_SCALE_STEP
        self.adjoint = sim3.adjoint(poses)
        self.inverse_adjoint = sim3.adjoint(sim3.inverse(poses))
        parts = (random,) if is_metric else (random, scale)
        self._noise = [self._summed(part) for part in parts]
        if joined is not None:
            self._noise[0] += self._summed(joined)
        self._bias = np.cumsum(self.adjoint * bias[:, None, :], axis=0)

    @property
    def kinds(self) -> int:
        """Number of the kinds of errors, whose variances have a factor each: poses, scale."""
        return len(self._noise)

    def _summed(self, sigma: Floats) -> Floats:
        scaled = self.adjoint * sigma[:, None, :]
        return np.asarray(np.cumsum(scaled @ np.swapaxes(scaled, 1, 2), axis=0))

    def along(self, steps: Floats) -> Floats:
        """(n, 7) errors of poses by those of their steps, each in the frame of its pose."""
        return np.asarray(np.cumsum((self.adjoint @ steps[:, :, None])[:, :, 0], axis=0))

    def steps(self, errors: Floats) -> Floats:
        """The inverse of `along`."""
        change = np.diff(errors, axis=0, prepend=np.zeros((1, 7)))
        return np.asarray((self.inverse_adjoint @ change[:, :, None])[:, :, 0])

    def measured(self, rows: Rows) -> list[Floats]:
        """(R, R) covariances of measurements by each kind of errors."""
        found = [np.zeros((len(rows.at), len(rows.at))) for _ in self._noise]
        for a, along_a in rows.ends:
            for b, along_b in rows.ends:
                for total, noise in zip(found, self._noise, strict=True):
                    total += _products(noise, a, b, along_a, along_b)
        by_bias = self._by_bias(rows)
        found[0] += by_bias @ by_bias.T
        return found

    def _by_bias(self, rows: Rows) -> Floats:
        """(R, 7) of measurements by the systematic errors of steps."""
        parts = [np.einsum("ri,rij->rj", along, self._bias[at]) for at, along in rows.ends]
        return np.asarray(sum(parts))

    def expected(self, rows: Rows, factors: Sequence[float], weighted: Floats) -> Floats:
        """(n, 7) errors, given a solution's `weighted`."""
        count = len(self.adjoint)
        result = np.zeros((count, 7))
        for at, along in rows.ends:
            force = along * weighted[:, None]
            for noise, factor in zip(self._noise, factors, strict=True):
                before, after = np.zeros((2, count, 7))
                np.add.at(before, at, np.einsum("rij,rj->ri", noise[at], force))
                np.add.at(after, at, force)
                later = after.sum(axis=0) - np.cumsum(after, axis=0)
                summed = np.cumsum(before, axis=0) + np.einsum("nij,nj->ni", noise, later)
                result += factor * summed
        result += factors[0] * self._bias @ (weighted @ self._by_bias(rows))
        return result

    def covariances(
        self,
        rows: Rows,
        factors: Sequence[float],
        solution: Solution,
        chosen: Ints,
        shared: Sequence[Floats],
    ) -> list[Floats]:
        """(m, 7, 7) covariances of errors of the chosen poses, after the measurements.

        `shared`: (7, P) what each parameter adds to the error of a pose, for each result.
        """
        results = [np.zeros((len(chosen), 7, 7)) for _ in shared]
        for begin in range(0, len(chosen), _CHUNK):
            part = chosen[begin : begin + _CHUNK]
            alone = factors[0] * self._bias[part] @ np.swapaxes(self._bias[part], 1, 2)
            crossed = np.zeros((len(part), 7, len(rows.at)))
            for noise, factor in zip(self._noise, factors, strict=True):
                alone = alone + factor * noise[part]
                for at, along in rows.ends:
                    by_row = np.einsum("rij,rj->ir", noise[at], along)
                    own = noise[part] @ along.T
                    is_before = (at <= part[:, None])[:, None, :]
                    crossed += factor * np.where(is_before, by_row, own)
            crossed += factors[0] * self._bias[part] @ self._by_bias(rows).T
            gain = crossed @ solution.information
            alone = alone - gain @ np.swapaxes(crossed, 1, 2)
            for result, each in zip(results, shared, strict=True):
                left = each - gain @ rows.trend
                spread = left @ solution.covariance @ np.swapaxes(left, 1, 2)
                result[begin : begin + len(part)] = alone + spread
        return results


def solve(rows: Rows, covariance: Floats, prior: Floats) -> Solution:
    """Solve for the parameters; `prior`: (P,) their information before the measurements."""
    information = np.asarray(np.linalg.inv(covariance), np.float64)
    with_trend = information @ rows.trend
    normal = rows.trend.T @ with_trend + np.diag(prior)
    spread = np.asarray(np.linalg.inv(normal), np.float64)
    found = spread @ (with_trend.T @ rows.residual)
    weighted = information @ (rows.residual - rows.trend @ found)
    return Solution(information, weighted, found, spread)


def log_likelihood(rows: Rows, covariance: Floats, prior: Floats) -> float:
    """Restricted logarithmic likelihood (Patterson and Thompson 1971), less a constant."""
    count, width = rows.trend.shape
    both = np.column_stack([rows.trend, rows.residual])
    joint = np.zeros((count + width + 1,) * 2)
    joint[:count, :count], joint[:count, count:], joint[count:, :count] = covariance, both, both.T
    joint[count:, count:] = np.eye(width + 1) * _LARGE
    try:
        lower = np.linalg.cholesky(joint)  # its last rows are those of `both`, made white
        white = lower[count:, :count].T
        normal = white[:, :-1].T @ white[:, :-1] + np.diag(prior)
        against = white[:, :-1].T @ white[:, -1]
        squared = float(white[:, -1] @ white[:, -1] - against @ np.linalg.solve(normal, against))
    except np.linalg.LinAlgError:
        return -np.inf
    log_diagonal = float(np.log(np.diag(lower)[:count]).sum())
    return -0.5 * (squared + 2.0 * log_diagonal + float(np.linalg.slogdet(normal)[1]))


def _products(noise: Floats, a: Ints, b: Ints, along_a: Floats, along_b: Floats) -> Floats:
    """(R, R) along_a_r @ noise[min(a_r, b_s)] @ along_b_s."""
    by_a = np.einsum("ri,rij->rj", along_a, noise[a]) @ along_b.T
    by_b = along_a @ np.einsum("rij,rj->ri", noise[b], along_b).T
    return np.asarray(np.where(a[:, None] <= b, by_a, by_b))
