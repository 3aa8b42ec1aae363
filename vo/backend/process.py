"""The smoother in a process of its own: GTSAM holds Python's lock all the while it works.

The process holds nothing but the window in hand. When it dies, another is started and given the
same window again, so that nothing is lost but time.
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
from vo.config import SmoothingConfig
from vo.types import WindowProblem

_log = logging.getLogger(__name__)

_ATTEMPTS = 2


class OptimizerProcess:
    """Hands windows to another process, which works on them until their answers are asked for.

    Args:
        config: its settings.
        child: the process, if it was started already.

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(self, config: SmoothingConfig, child: Popen[bytes] | None = None) -> None:
        # Bare numbers: the settings' classes would make its start a quarter longer.
        self._config = SimpleNamespace(**config.model_dump())
        self._children = [child or start_child()]  # one, until it is ended
        self._end = weakref.finalize(self, _end_all, self._children)
        self._problem: WindowProblem | None = None
        self._has_answered = False

    def ask(self, problem: WindowProblem) -> None:
        """Hand in a window; the one before must have been answered."""
        self._problem = problem
        with suppress(OSError):  # the process is dead: `answer` sees to that
            self._send(problem)

    def answer(self) -> WindowSolution:
        """Wait for the window that was handed in; left as it is if the process dies over it twice.

        Raises:
            RuntimeError: none was handed in, the process does not start, or what it does fails.
        """
        if self._problem is None:
            raise RuntimeError("no window was handed in")
        problem, self._problem = self._problem, None
        for attempt in range(_ATTEMPTS):
            if attempt > 0:
                with suppress(OSError):
                    self._send(problem)
            try:
                return self._receive()
            except (OSError, EOFError):
                self._replace()
        if not self._has_answered:
            raise RuntimeError("the smoother's process does not start; try with one thread")
        return unsolved(problem)

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._end()

    @property
    def _child(self) -> Popen[bytes]:
        if not self._children:
            raise RuntimeError("the smoother was closed")
        return self._children[0]

    def _send(self, problem: WindowProblem) -> None:
        pipe = self._child.stdin
        assert pipe is not None
        send(pipe, (problem, self._config))

    def _receive(self) -> WindowSolution:
        pipe = self._child.stdout
        assert pipe is not None
        answer: WindowSolution | str = receive(pipe)
        self._has_answered = True
        if isinstance(answer, str):
            raise RuntimeError(f"the smoother failed:\n{answer}")
        return answer

    def _replace(self) -> None:
        status = end_child(self._child)
        _log.warning("the smoother's process died (status %d) and is started again", status)
        self._children[:] = [start_child()]


def _end_all(children: list[Popen[bytes]]) -> None:
    while children:
        end_child(children.pop())
