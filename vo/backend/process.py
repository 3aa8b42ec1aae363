"""Optimizer in its own process, since GTSAM holds Python's global lock while it works.

The process keeps no state but the current window. When it dies, it is replaced and the window is
submitted again.
"""

from __future__ import annotations

import logging
import weakref
from contextlib import suppress
from subprocess import Popen
from types import SimpleNamespace

from vo.backend.launch import end_child, start_child
from vo.backend.messages import receive, send
from vo.backend.solution import WindowSolution, unsolved
from vo.backend.window_problem import WindowProblem
from vo.config import SmoothingConfig

_log = logging.getLogger(__name__)

_ATTEMPTS = 2


class OptimizerProcess:
    """Sends windows to another process, which works on them until their results are requested.

    Args:
        config: settings of the window.
        child: the process, if it was started already.

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(self, config: SmoothingConfig, child: Popen[bytes] | None = None) -> None:
        # Plain numbers: importing the settings' classes would take a quarter of its start-up.
        self._config = SimpleNamespace(**config.model_dump())
        self._children = [child or start_child()]  # one, until it is ended
        self._end = weakref.finalize(self, _end_all, self._children)
        self._problem: WindowProblem | None = None
        self._has_result = False

    def submit(self, problem: WindowProblem) -> None:
        """Submit a window, after the result of the one before."""
        self._problem = problem
        with suppress(OSError):  # the process is dead: `result` replaces it
            self._send(problem)

    def result(self) -> WindowSolution:
        """Wait for the solution; the window is left unsolved if the process dies over it twice.

        Raises:
            RuntimeError: no window was submitted, the process does not start, or it fails.
        """
        if self._problem is None:
            raise RuntimeError("no window was submitted")
        problem, self._problem = self._problem, None
        for attempt in range(_ATTEMPTS):
            if attempt > 0:
                with suppress(OSError):
                    self._send(problem)
            try:
                return self._receive()
            except (OSError, EOFError):
                self._replace()
        if not self._has_result:
            raise RuntimeError("the optimizer's process does not start; try `--set threads=1`")
        return unsolved(problem)

    def close(self) -> None:
        """Kill the process."""
        self._end()

    @property
    def _child(self) -> Popen[bytes]:
        if not self._children:
            raise RuntimeError("the optimizer was closed")
        return self._children[0]

    def _send(self, problem: WindowProblem) -> None:
        pipe = self._child.stdin
        assert pipe is not None
        send(pipe, (problem, self._config))

    def _receive(self) -> WindowSolution:
        pipe = self._child.stdout
        assert pipe is not None
        received: WindowSolution | str = receive(pipe)
        self._has_result = True
        if isinstance(received, str):
            raise RuntimeError(f"the optimizer failed:\n{received}")
        return received

    def _replace(self) -> None:
        status = end_child(self._child)
        _log.warning("the optimizer's process died (status %d) and is restarted", status)
        self._children[:] = [start_child()]


def _end_all(children: list[Popen[bytes]]) -> None:
    while children:
        end_child(children.pop())
