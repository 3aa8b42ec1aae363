"""The smoother in a process of its own: GTSAM holds Python's lock all the while it works.

The process holds nothing but the window in hand. When it dies, another is started and given the
same window again, so that nothing is lost but time.
"""

from __future__ import annotations

import logging
import subprocess
import threading
import weakref
from concurrent.futures import Future
from types import SimpleNamespace

from vo.config import SmoothingConfig
from vo.smoothing.child import end_child, start_child
from vo.smoothing.messages import receive, send
from vo.smoothing.solution import WindowSolution, unsolved
from vo.types import WindowProblem

_log = logging.getLogger(__name__)

_ATTEMPTS = 2


class SmootherProcess:
    """Hands windows to another process; a thread of this one waits for the answer.

    Args:
        config: its settings.
        child: the process, if it was started already.

    Raises:
        OSError: the process cannot be started.
    """

    def __init__(
        self, config: SmoothingConfig, child: subprocess.Popen[bytes] | None = None
    ) -> None:
        self._config = config
        self._child = _Child(child or start_child())
        self._stop = weakref.finalize(self, self._child.stop)
        self._answer: Future[WindowSolution] | None = None

    def ask(self, problem: WindowProblem) -> None:
        """Hand in a window; the one before must have been answered."""
        answer: Future[WindowSolution] = Future()
        self._answer = answer
        arguments = (self._child, problem, self._config, answer)
        # A daemon: the end of the program does not wait for it.
        threading.Thread(target=_fulfil, args=arguments, name="smoother", daemon=True).start()

    def answer(self) -> WindowSolution:
        """Wait for the window that was handed in."""
        if self._answer is None:
            raise RuntimeError("no window was handed in")
        answer, self._answer = self._answer, None
        return answer.result()

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._stop()


class _Child:
    """The process, replaced by another when it has died."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._stopped = False
        self._has_answered = False
        self._lock = threading.Lock()
        self._process = process

    def adjust(self, problem: WindowProblem, config: SmoothingConfig) -> WindowSolution:
        """Have a window adjusted; left as it is if the process dies over it time and again."""
        for _ in range(_ATTEMPTS):
            try:
                answer = self._exchange(problem, config)
            except (OSError, EOFError) as error:
                self._replace(error)
                continue
            if isinstance(answer, str):
                raise RuntimeError(f"the smoother failed:\n{answer}")
            return answer
        if not self._has_answered:
            raise RuntimeError("the smoother's process does not start; try with one thread")
        return unsolved(problem)

    def stop(self) -> None:
        """End it for good."""
        with self._lock:
            self._stopped = True
            end_child(self._process)

    def _exchange(self, problem: WindowProblem, config: SmoothingConfig) -> WindowSolution | str:
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        # Bare numbers: the settings' classes would make its start a quarter longer.
        send(process.stdin, (problem, SimpleNamespace(**config.model_dump())))
        answer: WindowSolution | str = receive(process.stdout)
        self._has_answered = True
        return answer

    def _replace(self, error: Exception) -> None:
        with self._lock:
            if self._stopped:
                raise RuntimeError("the smoother was closed") from error
            status = end_child(self._process)
            _log.warning("the smoother's process died (status %d) and is started again", status)
            self._process = start_child()


def _fulfil(
    child: _Child,
    problem: WindowProblem,
    config: SmoothingConfig,
    answer: Future[WindowSolution],
) -> None:
    try:
        answer.set_result(child.adjust(problem, config))
    except BaseException as error:  # whoever waits for the answer gets it
        answer.set_exception(error)
