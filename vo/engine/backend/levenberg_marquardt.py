"""Minimisation of the cost of a window by the method of Levenberg and Marquardt."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from vo.base.config import SmoothingConfig
from vo.base.types import Floats

_INITIAL_LAMBDA, _LAMBDA_FACTOR, _MAX_TRIES = 1e-4, 10.0, 5

State = TypeVar("State")


class Variables(Protocol[State]):
    """Variables with a cost."""

    def cost(self, state: State) -> float:
        """Half the squared errors."""
        ...

    def equations(self, state: State) -> tuple[Floats, Floats]:
        """Hessian (N, N) and gradient (N,) of the cost."""
        ...

    def moved(self, state: State, step: Floats) -> State:
        """The state after a step (N,)."""
        ...


def minimise(
    variables: Variables[State],
    start: State,
    config: SmoothingConfig,
    damping: Floats | None = None,
) -> State:
    """The state of least cost that is found from a first one.

    `damping`: (N,) what lambda is multiplied by, the diagonal of the hessian if not given.
    """
    state, factor, cost = start, _INITIAL_LAMBDA, variables.cost(start)
    for _ in range(config.iterations):
        hessian, gradient = variables.equations(state)
        scale = np.diag(hessian) if damping is None else damping
        for _ in range(_MAX_TRIES):
            damped = hessian + np.diag(factor * scale + 1e-12)
            try:
                step = -np.linalg.solve(damped, gradient)
            except np.linalg.LinAlgError:
                return state
            trial = variables.moved(state, np.asarray(step))
            new = variables.cost(trial)
            if new < cost:
                break
            factor *= _LAMBDA_FACTOR
        else:
            return state
        decrease, state, cost = cost - new, trial, new
        factor /= _LAMBDA_FACTOR
        if decrease < config.relative_error_tolerance * cost:
            break
    return state
