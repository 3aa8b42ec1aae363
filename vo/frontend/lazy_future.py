"""Work that can be begun ahead of time; what comes of it is the same either way."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Generic, TypeVar

T = TypeVar("T")


class LazyFuture(Generic[T]):
    """A result that is worked out when it is asked for, or in a thread before that.

    Args:
        work: gives the result.
        executor: where to begin ahead of time; None begins nothing.
    """

    def __init__(self, work: Callable[[], T], executor: Executor | None) -> None:
        self._work = work
        self._executor = executor
        self._future: Future[T] | None = None
        self.is_used = False  # whether the result was asked for, however early it was begun

    def begin(self) -> None:
        """Begin now, if there is a thread for it and that was not done before."""
        if self._executor is not None and self._future is None:
            self._future = self._executor.submit(self._work)

    def result(self) -> T:
        """Wait for the result; at the second time it is there.

        It comes from the executor, if there is one, where it cannot get in the way of others.
        """
        self.is_used = True
        self.begin()
        if self._future is None:
            result = self._work()
            self._future = Future()
            self._future.set_result(result)
        return self._future.result()
