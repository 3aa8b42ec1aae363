"""Windows are handed in and come back adjusted: at once here, or from a process of its own."""

from __future__ import annotations

import logging
from subprocess import Popen
from typing import Protocol

from vo.backend.process import OptimizerProcess
from vo.backend.solution import WindowSolution, smooth
from vo.config import SmoothingConfig
from vo.types import WindowProblem

_log = logging.getLogger(__name__)


class WindowOptimizer(Protocol):
    """Adjusts one window at a time; whichever it is, the same window gives the same bits."""

    def ask(self, problem: WindowProblem) -> None:
        """Hand in a window; the one before must have been answered."""
        ...

    def answer(self) -> WindowSolution:
        """Wait for the window that was handed in."""
        ...

    def close(self) -> None:
        """Let go of everything; nothing can be asked afterwards."""
        ...


class InProcessOptimizer:
    """Does the work in this process, when the answer is asked for."""

    def __init__(self, config: SmoothingConfig) -> None:
        self._config = config
        self._problem: WindowProblem | None = None

    def ask(self, problem: WindowProblem) -> None:
        """Keep a window for later."""
        self._problem = problem

    def answer(self) -> WindowSolution:
        """Adjust the window that was handed in."""
        if self._problem is None:
            raise RuntimeError("no window was handed in")
        problem, self._problem = self._problem, None
        return smooth(problem, self._config)

    def close(self) -> None:
        """There is nothing to let go of."""


def make_optimizer(
    config: SmoothingConfig, threads: int, child: Popen[bytes] | None = None
) -> WindowOptimizer:
    """A process of its own if there are cores for it: `child`, where that was started early."""
    if threads > 1:
        try:
            return OptimizerProcess(config, child)
        except OSError as error:
            _log.warning("smoothing in the same process, no other can be started: %s", error)
    return InProcessOptimizer(config)
