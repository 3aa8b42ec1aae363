"""Solvers in processes of their own, since GTSAM holds Python's global lock while it works.

A process keeps no state but the current problem. When it dies, it is replaced and the problem is
submitted again.
"""

from __future__ import annotations

import logging
import weakref
from collections.abc import Callable
from contextlib import suppress
from subprocess import Popen
from typing import Generic, TypeVar

from vo.engine.backend.launch import end_child, start_child
from vo.engine.backend.messages import receive, send

_log = logging.getLogger(__name__)

_ATTEMPTS = 2

Problem = TypeVar("Problem")
Solution = TypeVar("Solution")


class SolverProcess(Generic[Problem, Solution]):
    """Sends problems to another process, which works on them until their results are requested.

    Args:
        solver: function of a module, called there with the problem.
        left_alone: the solution of a problem that cannot be solved, made in this process.

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(
        self,
        solver: Callable[..., Solution],
        left_alone: Callable[[Problem], Solution],
    ) -> None:
        self._solver = solver
        self._left_alone = left_alone
        self._children = [start_child()]  # one, until it is ended
        self._end = weakref.finalize(self, _end_all, self._children)
        self._problem: Problem | None = None
        self._has_result = False

    def submit(self, problem: Problem) -> None:
        """Submit a problem, after the result of the one before."""
        self._problem = problem
        with suppress(OSError):  # the process is dead: `result` replaces it
            self._send(problem)

    def result(self) -> Solution:
        """Wait for the solution; the problem is left alone if the process dies over it twice.

        Raises:
            RuntimeError: nothing was submitted, the process does not start, or it fails.
        """
        if self._problem is None:
            raise RuntimeError("no problem was submitted")
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
            raise RuntimeError("the optimizer's process does not start; try `threads=1`")
        return self._left_alone(problem)

    def close(self) -> None:
        """Kill the process."""
        self._end()

    @property
    def _child(self) -> Popen[bytes]:
        if not self._children:
            raise RuntimeError("the optimizer was closed")
        return self._children[0]

    def _send(self, problem: Problem) -> None:
        pipe = self._child.stdin
        assert pipe is not None
        send(pipe, (self._solver, problem))

    def _receive(self) -> Solution:
        pipe = self._child.stdout
        assert pipe is not None
        received: Solution | str = receive(pipe)
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
