"""A graph of a path's keyframes, with positions, ways of wheels and loops as factors.

Variables are blocks of seven: similarities of keyframes in the frame of the positions, then slow
errors of groups of positions and of ways, then systematic errors of odometry, then what all have in
common (offset of the clock, radius of the wheels), then the shift of positions after each jump.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import skew
from vo.base.types import Floats, Ints
from vo.engine.backend.chain_motion import FIXED_LOG_SCALE, USUAL, ChainMotions
from vo.engine.backend.sparse_blocks import Couplings
from vo.engine.geometry import sim3
from vo.runs.scaling.path_factors import Fixes, Given, WayFactors, positions_of

_LOG_SCALE_STEP = 0.003  # random, of the logarithm of the scale in mono, for each step
_TURN_SIGMA, _CLOCK_SIGMA_S = 1.0, 0.05  # rad, of the frame of positions before; of their clock
_HELD, _FREE = 1e10, 1e-8  # information of what is known exactly, and of what is not known
_EXACT = 1e-6  # of the variances of odometry, for a path without drift
_SLOW_WAYS = 0.003, 60.0  # of all ways within a minute: load, ground, temperature


class Noise(NamedTuple):
    """Standard deviations along one axis.

    Attributes:
        white_m: of errors that are independent.
        slow_m: of a first-order Markov process.
        time_s: after which its correlation is 1/e.
        factors: of the variances of each kind of errors of odometry; none for a path without.
    """

    white_m: float
    slow_m: float
    time_s: float
    factors: tuple[float, ...] = ()


class State(NamedTuple):
    """Poses (K, 4, 4) of keyframes, and all other variables (N, 7)."""

    poses: Floats
    other: Floats


class Factors(NamedTuple):
    """E errors (E, r) of m variables each: their numbers (E, m), and derivatives (E, m, r, 7).

    Attributes:
        information: (E, r, r).
    """

    nodes: Ints
    by_node: Floats
    error: Floats
    information: Floats

    @property
    def squared(self) -> float:
        """Sum of the squared errors, in variances."""
        return float(np.einsum("ei,eij,ej->", self.error, self.information, self.error))

    @property
    def log_information(self) -> float:
        """Logarithm of the determinant of the information; 0 where there is none."""
        return (
            float(np.linalg.slogdet(self.information)[1].sum()) if self.information.any() else 0.0
        )


class PathMotions:
    """Motions of n keyframes by odometry, with both kinds of its errors: poses, and scale.

    Args:
        poses: (n, 4, 4) similarities.
        given: whether the scale cannot drift; further errors of steps, across gaps.
    """

    def __init__(self, poses: Floats, given: Given) -> None:
        self.poses, self._is_metric = poses, given.is_metric
        self.kinds = 1 if given.is_metric else 2  # that have a factor each
        steps = sim3.inverse(poses[:-1]) @ poses[1:]
        length = np.linalg.norm(steps[:, :3, 3], axis=1)[:, None]
        angle = np.linalg.norm(sim3.local(steps)[:, :3], axis=1)[:, None]
        sigma, drift = np.zeros((2, len(poses), 7)), np.zeros((len(poses), 7))
        sigma[0, 1:, :3], sigma[0, 1:, 3:6] = USUAL.step_rad, USUAL.step_ratio * length + 1e-6
        sigma[1, 1:, 6] = FIXED_LOG_SCALE if given.is_metric else _LOG_SCALE_STEP
        drift[1:, :3], drift[1:, 3:6] = USUAL.rotation_ratio * angle, USUAL.ratio * length
        self._noise = sigma[:, :, :, None] ** 2 * np.eye(7)
        if given.joined is not None:
            self._noise[0] += given.joined[:, :, None] ** 2 * np.eye(7)
        self._drift = drift[:, :, None] * np.eye(7)

    def _chain(self, noise: Floats) -> ChainMotions:
        return ChainMotions(self.poses, noise, np.zeros_like(noise))

    def with_factors(self, noise: Noise) -> ChainMotions:
        """With their random errors as they were estimated."""
        first, second = self._both(noise)
        return self._chain(first * self._noise[0] + second * self._noise[1])

    def between(self, a: Ints, b: Ints) -> tuple[Callable[[Noise], Floats], Floats]:
        """Of motions (E, 7, 7) covariances of random errors, by the noise, and systematic ones."""
        poses, scale = (self._chain(each).covariance(a, b) for each in self._noise)
        by_drift = ChainMotions(self.poses, self._noise[0], self._drift).systematic(a, b)
        return lambda noise: np.tensordot(self._both(noise), (poses, scale), 1), by_drift

    def _both(self, noise: Noise) -> tuple[float, float]:
        factors = noise.factors or (_EXACT, _EXACT)
        return factors[0], 1.0 if self._is_metric else factors[1]


class PathGraph:
    """The least-squares problem of a path: see `levenberg_marquardt.Problem`.

    Attributes:
        knots: (K,) rows of the keyframes that are variables.
        start: poses as they are, and no other errors.
        times_s: (G,) of the positions.
        noise: of them and of odometry.
    """

    def __init__(
        self,
        motions: PathMotions,
        poses: Floats,
        knots: Ints,
        fixes: Fixes,
        piece: Ints,
        axes: Floats,
        given: Given,
    ) -> None:
        self.knots, self.noise = knots, Noise(1.0, 1.0, 1.0)
        self.times_s = fixes.times_s
        self._fixes, self._ways, self._axes = fixes, given.ways, axes
        at, ways = np.searchsorted(knots, fixes.at), len(given.ways.at) if given.ways else 0
        slow = len(knots) + np.arange(len(at) + ways)
        self._drift = len(knots) + len(slow)
        self._common = self._drift + 1
        self._slow, self._slow_ways = slow[: len(at)], slow[len(at) :]
        shift = self._common + 1 + piece
        self._of_fixes = np.column_stack([at, self._slow, np.full_like(at, self._common), shift])
        a, b = np.arange(len(knots) - 1), np.arange(1, len(knots))
        self._spread, by_drift = motions.between(knots[a], knots[b])
        loops = given.loops
        self._a = np.r_[a, np.searchsorted(knots, loops.a)]
        self._b = np.r_[b, np.searchsorted(knots, loops.b)]
        self._of_loops = np.linalg.inv(loops.covariance)
        self._by_drift = np.concatenate([by_drift, np.zeros_like(self._of_loops)])
        before = motions.poses[knots]
        self._back = sim3.inverse(before[self._b]) @ before[self._a]
        pieces = int(piece.max(initial=0)) + 1
        self.start = State(poses[knots], np.zeros((len(slow) + 2 + pieces, 7)))
        self._held = self._known(given, piece)
        self._link()

    def _known(self, given: Given, piece: Ints) -> Floats:
        """(K + N, 7) information before the measurements."""
        held = np.ones((len(self.knots) + len(self.start.other), 7))
        held[: len(self.knots)] = 0.0
        held[0, :3], held[0, 3:] = _TURN_SIGMA**-2, _FREE
        if not len(piece):
            held[0, :6] = _HELD
        if given.is_metric:
            held[0, 6] = FIXED_LOG_SCALE**-2
        elif given.scale_sigma is not None:
            held[0, 6] = given.scale_sigma**-2
        held[self._drift] = 0.0
        held[len(self.knots) : self._drift, :3] = _FREE
        held[self._common, 0] = _CLOCK_SIGMA_S**-2
        if given.ways is not None:
            held[self._common, 1] = given.ways.radius_sigma**-2
        held[self._common + 1 :] = _FREE
        if len(piece):
            held[self._common + 1 + np.bincount(piece).argmax()] = _HELD
        return held

    def _link(self) -> None:
        """Find which variables are coupled; the first pose with all others, for covariances."""
        rows = np.arange(len(self.knots))
        nodes = [each.nodes for each in self._factors(self.start)]
        nodes.append(np.column_stack([np.zeros_like(rows), rows]))
        self._pairs = [np.triu_indices(each.shape[1]) for each in nodes]
        pairs = zip(nodes, self._pairs, strict=True)
        ends = [each[:, pair].transpose(0, 2, 1).reshape(-1, 2) for each, pair in pairs]
        self._after = np.cumsum([len(each) for each in ends])
        self._couplings = Couplings(len(self._held), *np.concatenate(ends).T)

    def _factors(self, state: State) -> list[Factors]:
        """Of odometry and loops, its systematic errors, positions and ways."""
        return [
            *self._odometry(state),
            _markov(self._slow, self.times_s, state, self.noise.slow_m, self.noise.time_s),
            self._positions(state),
            *([] if self._ways is None else self._wheels(self._ways, state)),
        ]

    def _odometry(self, state: State) -> tuple[Factors, Factors]:
        a, b = state.poses[self._a], state.poses[self._b]
        by_a, factors = -sim3.adjoint(sim3.inverse(b) @ a), self.noise.factors or (_EXACT,)
        by_b = np.broadcast_to(np.eye(7), by_a.shape)
        drift = state.other[self._drift - len(self.knots)]
        motions = Factors(
            np.column_stack([self._a, self._b, np.full_like(self._a, self._drift)]),
            np.stack([by_a, by_b, -self._by_drift], axis=1),
            sim3.local(self._back @ sim3.inverse(a) @ b) - self._by_drift @ drift,
            np.concatenate([np.linalg.inv(self._spread(self.noise)), self._of_loops]),
        )
        one, unit = np.array([[self._drift]]), np.eye(7)[None]
        return motions, Factors(one, unit[None], drift[None], unit / factors[0])

    def _positions(self, state: State) -> Factors:
        fixes, at = self._fixes, self._of_fixes[:, 0]
        other = state.other[self._of_fixes[:, 1:] - len(self.knots)]
        turned, unit = state.poses[at, :3, :3], np.broadcast_to(np.eye(3), (len(at), 3, 3))
        along = np.concatenate([-skew(fixes.in_cam), unit, fixes.in_cam[:, :, None]], axis=2)
        by_node = np.zeros((len(at), 4, 3, 7))
        by_node[:, 0] = turned @ along
        by_node[:, 1, :, :3], by_node[:, 3, :, :3] = np.diag(self._axes), unit
        by_node[:, 2, :, 0] = fixes.velocity
        further = np.einsum("gnij,gnj->gi", by_node[:, 1:], other)
        error = positions_of(state.poses, replace(fixes, at=at)) + further - fixes.xyz
        sigma = self.noise.white_m * fixes.sigma[:, None] * self._axes
        return Factors(self._of_fixes, by_node, error, sigma[:, None] ** -2 * unit)

    def _wheels(self, ways: WayFactors, state: State) -> tuple[Factors, Factors]:
        at, since = np.searchsorted(self.knots, [ways.at, ways.since])
        chord = state.poses[at, :3, 3] - state.poses[since, :3, 3]
        straight = np.linalg.norm(chord, axis=1)
        length = ways.bend * straight
        along = (ways.bend / np.maximum(straight, 1e-300))[:, None, None] * chord[:, None]
        by_node = np.zeros((len(at), 4, 1, 7))
        by_node[:, 0, :, 3:6] = along @ state.poses[at, :3, :3]
        by_node[:, 1, :, 3:6] = -along @ state.poses[since, :3, :3]
        by_node[:, 2, 0, 0], by_node[:, 3, 0, 1] = ways.way_m, length
        nodes = np.column_stack([at, since, self._slow_ways, np.full_like(at, self._common)])
        other = state.other[nodes[:, 2:] - len(self.knots)]
        error = (length - ways.way_m)[:, None] + np.einsum("gnij,gnj->gi", by_node[:, 2:], other)
        slow = _markov(self._slow_ways, ways.times_s, state, *_SLOW_WAYS)
        return slow, Factors(nodes, by_node, error, 1.0 / ways.variance[:, None, None])

    def _off(self, state: State) -> Floats:
        """(K + N, 7) how far variables are from what was known before."""
        poses = np.zeros((len(self.knots), 7))
        poses[0] = sim3.local(sim3.inverse(self.start.poses[0]) @ state.poses[0])
        return np.concatenate([poses, state.other])

    def cost(self, state: State) -> float:
        """Half the squared errors."""
        before = float((self._held * self._off(state) ** 2).sum())
        return 0.5 * (before + sum(each.squared for each in self._factors(state)))

    def steps(self, state: State) -> Callable[[float], Floats]:
        """By all damping alike."""
        matrix, gradient = self._equations(state, self._factors(state))
        return lambda damping: self._couplings.solve(matrix, self._held + damping, -gradient)[0]

    def moved(self, state: State, step: Floats) -> State:
        """The state after a step."""
        count = len(self.knots)
        return State(state.poses @ sim3.retract(step[:count]), state.other + step[count:])

    def _equations(self, state: State, factors: Sequence[Factors]) -> tuple[Floats, Floats]:
        gradient, found = self._held * self._off(state), []
        for each, (i, j) in zip(factors, self._pairs[:-1], strict=True):
            weighted = np.swapaxes(each.by_node, 2, 3) @ each.information[:, None]
            np.add.at(gradient, each.nodes, (weighted @ each.error[:, None, :, None])[..., 0])
            found.append((weighted[:, i] @ each.by_node[:, j]).reshape(-1, 7, 7))
        found.append(np.zeros((3 * len(self.knots), 7, 7)))
        return self._couplings.matrix(np.concatenate(found)), gradient

    def log_evidence(self) -> float:
        """Of the noise, given the path as it is, less a constant.

        Loops agree with the path whatever its drift: they are known, and not explained.
        """
        factors = self._factors(self.start)
        value = self._log_evidence(factors, self._held)
        if len(self._of_loops) == 0:
            return value
        unused = [each._replace(information=0.0 * each.information) for each in factors[2:]]
        held = np.concatenate([np.full((1, 7), _HELD), self._held[1:]])  # as nothing says where
        return value - self._log_evidence([*factors[:2], *unused], held)

    def _log_evidence(self, factors: Sequence[Factors], held: Floats) -> float:
        matrix, gradient = self._equations(self.start, factors)
        try:
            step, bend = self._couplings.solve(matrix, held, gradient)
        except np.linalg.LinAlgError:
            return -np.inf
        gain = float((gradient * step).sum()) - bend
        return 0.5 * (gain + sum(each.log_information - each.squared for each in factors))

    def covariances(self, state: State) -> tuple[Floats, Floats, Floats]:
        """Of keyframes (K, 7, 7), of each with the next (K - 1, 7, 7) and the first with it."""
        count, (single, pairs) = len(self.knots), self._inverse(state)
        return single[:count], pairs[0][: count - 1, 1], pairs[-1][:, 1]

    def _inverse(self, state: State) -> tuple[Floats, list[Floats]]:
        """Covariances of variables, and of all pairs of each factor."""
        matrix, _ = self._equations(state, self._factors(state))
        single, found = self._couplings.inverse_blocks(matrix, self._held)
        parts = zip(np.split(found, self._after[:-1]), self._pairs, strict=True)
        return single, [part.reshape(-1, len(pair[0]), 7, 7) for part, pair in parts]

    def contradiction(self, state: State) -> Floats:
        """(G,) squared distances of positions from what all others predict, in variances."""
        fixes, between, (i, j) = self._positions(state), self._inverse(state)[1][3], self._pairs[3]
        known = fixes.by_node[:, i] @ between @ np.swapaxes(fixes.by_node[:, j], 2, 3)
        known[:, i == j] *= 0.5
        known = known.sum(axis=1)
        left = np.linalg.inv(fixes.information) - known - np.swapaxes(known, 1, 2)
        error = fixes.error[:, :, None]
        return np.asarray((error * np.linalg.solve(left, error)).sum(axis=(1, 2)))


def _markov(nodes: Ints, times_s: Floats, state: State, sigma: float, time_s: float) -> Factors:
    """Slow errors along three axes, each with a part of the one before."""
    part = np.r_[0.0, np.exp(-np.diff(times_s) / time_s)][:, None, None][: len(nodes)]
    before = nodes[np.maximum(np.arange(len(nodes)) - 1, 0)]
    unit = np.eye(3, 7)
    first = len(state.poses)
    by_node = np.stack([-part * unit, np.broadcast_to(unit, (len(nodes), 3, 7))], axis=1)
    error = state.other[nodes - first, :3] - part[:, 0] * state.other[before - first, :3]
    variance = sigma**2 * np.maximum(1.0 - part**2, 1e-9)
    return Factors(np.column_stack([before, nodes]), by_node, error, np.eye(3) / variance)
