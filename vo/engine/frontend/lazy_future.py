"""A future whose work starts on demand; the result does not depend on when it starts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import Generic, TypeVar

T = TypeVar("T")
Item = TypeVar("Item")


class LazyFuture(Generic[T]):
    """A result that is computed when it is needed, or in a thread before that."""

    def __init__(self, work: Callable[[], T], executor: Executor | None) -> None:
        self._work = work
        self._executor = executor
        self._future: Future[T] | None = None
        self.is_used = False  # whether `result` was called, however early the work began

    def start(self) -> None:
        """Start now, if there is a thread for it and the work has not started."""
        if self._executor is not None and self._future is None:
            self._future = self._executor.submit(self._work)

    def result(self) -> T:
        """Wait for the result, which is kept.

        The work is done by the executor, if there is one, so that its thread alone does such work.
        """
        self.is_used = True
        self.start()
        if self._future is None:
            result = self._work()
            self._future = Future()
            self._future.set_result(result)
        return self._future.result()


def finished(value: T) -> LazyFuture[T]:
    """A future whose result is there already."""
    return LazyFuture(lambda: value, None)


def each_started_early(
    items: Iterable[Item], submit: Callable[[Item], LazyFuture[T]]
) -> Iterator[LazyFuture[T]]:
    """The futures of all items, each started before the one before it is used."""
    waiting: LazyFuture[T] | None = None
    try:
        for item in items:
            coming = submit(item)
            coming.start()
            if waiting is not None:
                yield waiting
            waiting = coming
    except Exception:
        if waiting is not None:  # an item that was read before the error still counts
            yield waiting
        raise
    if waiting is not None:
        yield waiting
