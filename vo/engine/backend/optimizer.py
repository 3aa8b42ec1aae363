"""Optimizers of windows: in a thread of their own, or when the result is requested."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

from vo.base.config import SmoothingConfig
from vo.base.scheduling import give_way
from vo.engine.backend.solution import WindowSolution, solve
from vo.engine.backend.window_problem import WindowProblem


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


class DeferredOptimizer:
    """Optimises when the result is requested."""

    def __init__(self, config: SmoothingConfig) -> None:
        self._config = config
        self._result: Callable[[], WindowSolution] | None = None

    def submit(self, problem: WindowProblem) -> None:
        """Keep a window until its result is requested."""
        self._result = lambda: solve(problem, self._config)

    def result(self) -> WindowSolution:
        """Optimise the submitted window."""
        if self._result is None:
            raise RuntimeError("no window was submitted")
        result, self._result = self._result, None
        return result()

    def close(self) -> None:
        """Nothing to release."""


class ThreadOptimizer(DeferredOptimizer):
    """Optimises while frames are tracked: nearly all is compiled, without Python's global lock."""

    def __init__(self, config: SmoothingConfig) -> None:
        super().__init__(config)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="window", initializer=give_way)

    def submit(self, problem: WindowProblem) -> None:
        """Begin to optimise a window, which nothing may change."""
        self._result = self._thread.submit(solve, problem, self._config).result

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)


def make_optimizer(config: SmoothingConfig, threads: int) -> WindowOptimizer:
    """An optimizer in a thread of its own, where there is more than one core."""
    return ThreadOptimizer(config) if threads > 1 else DeferredOptimizer(config)
