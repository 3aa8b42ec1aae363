"""Bundle adjustment of a window of a rig, whose views are tied to the poses of its body.

The observations are linearised by views, as those of a single camera; their normal equations are
then taken to the bodies by the adjoints of the views on them: H_body = A^T H_views A.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.geometry.transforms import adjoint, inverse, orthonormalised, se3_exp
from vo.base.types import Bools, Floats
from vo.engine.backend.bundle import Bundle, NormalEquations
from vo.engine.backend.bundle_adjustment import well_observed
from vo.engine.backend.residuals import residuals, with_measured_noise
from vo.engine.backend.window_problem import Ties, WindowProblem
from vo.engine.geometry.levenberg_marquardt import Law, dense_steps, minimise

_SCALE_SIGMA = 0.02  # of the distance of the farthest body, where nothing else gives the scale


class _State(NamedTuple):
    """Poses (B, 4, 4) of the bodies, and the change of the length of a metre in the map."""

    bodies: Floats
    metre: float


class AdjustedRig(NamedTuple):
    """Result for a window of K views of B bodies and M points.

    Attributes:
        held: (B,) bodies that stayed where they were.
        point_ok: (M,) False for points with one observation, or behind a view at the end.
        metre: change of the length of a metre in the map.
        ties: how the views are tied to the bodies.
        gauge: (6 B,) information on the bodies that holds the scale of a new map.
    """

    world_from_cam: Floats
    held: Bools
    points: Floats
    point_ok: Bools
    metre: float
    ties: Ties
    gauge: Floats

    def information(self, by_views: Floats) -> tuple[Floats, float]:
        """That on the bodies, and on the length of a metre, by that on the views (6 K, 6 K)."""
        of_body = adjoint(inverse(self.ties.body_from_view))
        on_bodies = _of_bodies(by_views, of_body, self.ties.views)
        if self.ties.lever is None:
            return on_bodies, 0.0
        free, by_metre = np.flatnonzero(np.repeat(~self.held, 6)), _by_metre(self.ties)
        coupled = by_views @ by_metre
        coupling = _of_body(coupled, of_body, self.ties.views)[free]
        own = float(by_metre @ coupled)
        inverse_free = np.linalg.pinv(on_bodies[np.ix_(free, free)], hermitian=True)
        on_bodies[np.diag_indices_from(on_bodies)] += self.gauge
        return on_bodies, max(0.0, own - float(coupling @ inverse_free @ coupling))


def adjust_rig(problem: WindowProblem, ties: Ties, config: SmoothingConfig) -> AdjustedRig | None:
    """Optimise a window of a rig; None where no landmark constrains its poses."""
    window = _RigWindow(problem, ties, config)
    held, ok = window.held, window.point_ok
    if held.all() or not ok[problem.point].any():
        return None
    state = window.optimise()
    poses = window.poses(state)
    points = window.bundle.points_for(poses)
    if not (np.isfinite(poses).all() and np.isfinite(points[ok]).all()):
        return None
    depth = residuals(problem, poses, points).depth
    ok[problem.point[~(depth > 0)]] = False
    return AdjustedRig(poses, held, points, ok, state.metre, ties, window.gauge)


class _RigWindow:
    """A window with its bodies as variables, and with the length of a metre where it is unknown."""

    def __init__(self, problem: WindowProblem, ties: Ties, config: SmoothingConfig) -> None:
        self._ties, self._config = ties, config
        self._start = problem.world_from_cam[:: ties.views] @ inverse(
            ties.body_from_view[:: ties.views]
        )
        self.held = problem.fixed[:: ties.views].copy()
        if not self.held.any():
            self.held[0] = True
        start = residuals(problem, problem.world_from_cam, problem.points)
        self.point_ok = well_observed(problem, start.depth)
        self._free = np.flatnonzero(~self.held)
        # A metre of another length moves the views of held bodies too.
        moves = np.ones(len(self.held), bool) if ties.lever is not None else ~self.held
        fixed = ~np.repeat(moves, ties.views)
        weighted = replace(with_measured_noise(problem, start), fixed=fixed)
        self.bundle = Bundle(weighted, self.point_ok, config)
        moving = np.flatnonzero(np.repeat(moves, ties.views))
        self._of_body = adjoint(inverse(ties.body_from_view[moving]))
        # The rows of the free bodies among those that move, and the column of the metre.
        self._rows = np.flatnonzero(np.repeat((~self.held)[moves], 6))
        self._by_metre = None if ties.lever is None else _by_metre(ties)
        self._prior = self._scale_prior()

    def poses(self, state: _State) -> Floats:
        """(K, 4, 4) of the views."""
        ties, tied = self._ties, self._ties.body_from_view
        if ties.lever is not None:
            tied = tied.copy()
            tied[:, :3, 3] += state.metre * ties.lever
        return np.asarray(np.repeat(state.bodies, ties.views, axis=0) @ tied)

    def optimise(self) -> _State:
        """Minimise by Levenberg and Marquardt."""
        law = Law(self._config.iterations, self._config.relative_error_tolerance)
        return minimise(self, _State(self._start.copy(), 0.0), law)

    def cost(self, state: _State) -> float:
        """Half the squared errors."""
        by_prior = 0.5 * float(self._prior @ self._off(state) ** 2)
        return self.bundle.cost(self.poses(state)) + by_prior

    def steps(self, state: _State) -> Callable[[float], Floats]:
        """Damped by the diagonal of the hessian."""
        hessian, gradient = self._reduced(self.bundle.normal_equations(self.poses(state)))
        hessian[np.diag_indices_from(hessian)] += self._prior
        return dense_steps(hessian, gradient + self._prior * self._off(state))

    def moved(self, state: _State, step: Floats) -> _State:
        """The state after a step."""
        bodies = state.bodies.copy()
        for n, k in enumerate(self._free.tolist()):
            bodies[k] = orthonormalised(bodies[k] @ se3_exp(step[6 * n : 6 * n + 6]))
        return _State(bodies, state.metre + (0.0 if self._ties.lever is None else float(step[-1])))

    def _reduced(self, normal: NormalEquations) -> tuple[Floats, Floats]:
        """Hessian and gradient of the variables."""
        views, rows = self._ties.views, self._rows
        hessian = _of_bodies(normal.hessian, self._of_body, views)[np.ix_(rows, rows)]
        gradient = _of_body(normal.gradient, self._of_body, views)[rows]
        if self._by_metre is None:
            return hessian, gradient
        coupled = normal.hessian @ self._by_metre
        side = _of_body(coupled, self._of_body, views)[rows]
        corner = float(self._by_metre @ coupled)
        whole = np.block([[hessian, side[:, None]], [side[None], np.array([[corner]])]])
        return whole, np.append(gradient, self._by_metre @ normal.gradient)

    @property
    def gauge(self) -> Floats:
        """(6 B,) information on the bodies by the prior."""
        of_bodies = np.zeros(6 * len(self.held))
        of_bodies[np.repeat(~self.held, 6)] = self._prior[: 6 * len(self._free)]
        return of_bodies

    def _scale_prior(self) -> Floats:
        """Information on single variables: keeps the scale of a new map, and what is known."""
        prior = np.zeros(len(self._rows) + (self._ties.lever is not None))
        if self._ties.lever is None:
            return prior
        prior[-1] = self._ties.lever_information
        if self.held.sum() < 2:
            distance = np.linalg.norm(self._start[:, :3, 3] - self._start[0, :3, 3], axis=1)
            farthest = int(np.argmax(np.where(self.held, 0.0, distance)))
            at = 6 * int(np.searchsorted(self._free, farthest))
            prior[at + 3 : at + 6] = (_SCALE_SIGMA * max(distance[farthest], 1e-6)) ** -2.0
        return prior

    def _off(self, state: _State) -> Floats:
        """What each variable is off its start, where there is a prior on it."""
        moved = inverse(self._start[self._free]) @ state.bodies[self._free]
        off = np.zeros((len(self._free), 6))
        off[:, 3:] = moved[:, :3, 3]
        metre = [] if self._ties.lever is None else [state.metre]
        return np.concatenate([off.ravel(), metre])


def _by_metre(ties: Ties) -> Floats:
    """(6 K,) how the tangents of the views change with the length of a metre."""
    assert ties.lever is not None
    column = np.zeros((len(ties.lever), 6))
    column[:, 3:] = np.einsum("kij,ki->kj", ties.body_from_view[:, :3, :3], ties.lever)
    return column.ravel()


def reduced_to_bodies(
    normal: NormalEquations, ties: Ties, columns: Floats
) -> tuple[Floats, Floats, Floats]:
    """A^T H A, A^T g, and A^T of further columns (6 K, N), where all K views may move."""
    of_body = adjoint(inverse(ties.body_from_view))
    by_column = [_of_body(column, of_body, ties.views) for column in columns.T]
    gradient = _of_body(normal.gradient, of_body, ties.views)
    return _of_bodies(normal.hessian, of_body, ties.views), gradient, np.stack(by_column, axis=1)


def _of_bodies(by_views: Floats, of_body: Floats, views: int) -> Floats:
    """A^T H A (6 B, 6 B) of H (6 K, 6 K), with the adjoints (K, 6, 6) of the views on their bodies.

    In blocks: a dense A has hardly anything but zeros.
    """
    count = len(of_body)
    blocks = by_views.reshape(count, 6, count, 6).transpose(0, 2, 1, 3)
    blocks = of_body.swapaxes(1, 2)[:, None] @ blocks @ of_body[None]
    bodies = count // views
    summed = blocks.reshape(bodies, views, bodies, views, 6, 6).sum(axis=(1, 3))
    return np.asarray(summed.transpose(0, 2, 1, 3).reshape(6 * bodies, 6 * bodies))


def _of_body(by_views: Floats, of_body: Floats, views: int) -> Floats:
    """A^T g (6 B,) of g (6 K,)."""
    turned = np.einsum("kij,ki->kj", of_body, by_views.reshape(-1, 6))
    return np.asarray(turned.reshape(-1, views, 6).sum(axis=1).ravel())
