"""Optimizers of windows: in this process, or in one of their own."""

from __future__ import annotations

import logging
from subprocess import Popen
from typing import Protocol

from vo.base.config import SmoothingConfig
from vo.engine.backend.process import OptimizerProcess
from vo.engine.backend.solution import WindowSolution, solve
from vo.engine.backend.window_problem import WindowProblem

_log = logging.getLogger(__name__)


class WindowOptimizer(Protocol):
    """Optimises one window at a time. All implementations give the same bits."""

    def submit(self, problem: WindowProblem) -> None:
        """Submit a window, after the result of the one before."""
        ...

    def result(self) -> WindowSolution:
        """Wait for the solution of the submitted window."""
        ...

    def close(self) -> None:
        """Release all resources; nothing can be submitted afterwards."""
        ...


class InProcessOptimizer:
    """Optimises in this process, when the result is requested."""

    def __init__(self, config: SmoothingConfig) -> None:
        self._config = config
        self._problem: WindowProblem | None = None

    def submit(self, problem: WindowProblem) -> None:
        """Keep a window until its result is requested."""
        self._problem = problem

    def result(self) -> WindowSolution:
        """Optimise the submitted window."""
        if self._problem is None:
            raise RuntimeError("no window was submitted")
        problem, self._problem = self._problem, None
        return solve(problem, self._config)

    def close(self) -> None:
        """Nothing to release."""


def make_optimizer(
    config: SmoothingConfig, threads: int, child: Popen[bytes] | None = None
) -> WindowOptimizer:
    """An optimizer in its own process, where there is more than one core; child may run already."""
    if threads > 1:
        try:
            return OptimizerProcess(config, child)
        except OSError as error:
            _log.warning("optimising in this process, no other can be started: %s", error)
    return InProcessOptimizer(config)
