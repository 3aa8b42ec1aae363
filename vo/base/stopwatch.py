"""Wall time by stage, measured around methods by a decorator."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Stopwatch:
    """Sums milliseconds by stage; a stage inside another one pauses the outer stage."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = {}
        self._running: list[str] = []
        self._since = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time inside towards a stage."""
        self.begin(name)
        try:
            yield
        finally:
            self.end()

    def begin(self, name: str) -> None:
        """Begin a stage; `end` has to follow."""
        self.switch().append(name)

    def end(self) -> None:
        """End the stage that was begun last."""
        self.switch().pop()

    def take(self) -> dict[str, float]:
        """The times since the last call, which are then forgotten."""
        self.switch()
        taken, self.stage_ms = self.stage_ms, {}
        return taken

    def switch(self) -> list[str]:
        """Count the time until now towards the innermost running stage; all that are running."""
        now = time.perf_counter()
        if self._running:
            name = self._running[-1]
            self.stage_ms[name] = self.stage_ms.get(name, 0.0) + (now - self._since) * 1e3
        self._since = now
        return self._running


class _Timed(Protocol):
    stopwatch: Stopwatch


S = TypeVar("S", bound=_Timed)


def timed(
    stage: str,
) -> Callable[[Callable[Concatenate[S, P], R]], Callable[Concatenate[S, P], R]]:
    """Decorate a method of an object with a `stopwatch`: its time counts towards a stage."""

    def decorate(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
        @wraps(method)
        def timed_method(self: S, /, *args: Any, **kwargs: Any) -> R:
            stopwatch = self.stopwatch
            stopwatch.switch().append(stage)  # as `begin` and `end`, with half of the calls
            try:
                return method(self, *args, **kwargs)
            finally:
                stopwatch.switch().pop()

        return timed_method

    return decorate
