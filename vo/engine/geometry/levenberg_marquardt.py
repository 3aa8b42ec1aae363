"""Minimisation of a cost by the method of Levenberg and Marquardt."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from vo.base.types import Floats

State = TypeVar("State")
Step = TypeVar("Step")  # often (N,)


class Law(NamedTuple):
    """How damping follows success, and when iterations end.

    Attributes:
        iterations: steps, the most.
        tolerance: decrease of the cost, relative to it, below which no step follows.
        damping: of the first step.
        least: damping.
        most: damping, above which nothing is tried.
        tries: of one step with growing damping.
        factor: of the damping after a step that fails; the inverse after one that does not.
    """

    iterations: int
    tolerance: float
    damping: float = 1e-4
    least: float = 0.0
    most: float = np.inf
    tries: int = 5
    factor: float = 10.0


class Problem(Protocol[State, Step]):
    """Variables with a cost."""

    def cost(self, state: State) -> float:
        """Half the squared errors."""
        ...

    def steps(self, state: State) -> Callable[[float], Step]:
        """Linearise: the step for each damping, with LinAlgError where there is none."""
        ...

    def moved(self, state: State, step: Step) -> State:
        """The state after a step."""
        ...


def minimise(problem: Problem[State, Step], start: State, law: Law) -> State:
    """The state of least cost that is found from a first one."""
    state, damping, cost = start, law.damping, problem.cost(start)
    for _ in range(law.iterations):
        step_with = problem.steps(state)
        for _ in range(law.tries):
            if damping > law.most:
                return state
            try:
                trial = problem.moved(state, step_with(damping))
                new = problem.cost(trial)
            except np.linalg.LinAlgError:
                new = np.inf
            if new < cost:
                break
            damping *= law.factor
        else:
            return state
        decrease, state, cost = cost - new, trial, new
        damping = max(damping / law.factor, law.least)
        if decrease < law.tolerance * cost:
            break
    return state


def dense_steps(
    hessian: Floats, gradient: Floats, scale: Floats | None = None
) -> Callable[[float], Floats]:
    """Steps by a hessian (N, N) and a gradient (N,) of the cost.

    `scale`: (N,) what the damping is multiplied by, the diagonal of the hessian if not given.
    """
    scale = np.diag(hessian) if scale is None else scale

    def step(damping: float) -> Floats:
        damped = hessian + np.diag(damping * scale + 1e-12)
        return np.asarray(-np.linalg.solve(damped, gradient))

    return step
