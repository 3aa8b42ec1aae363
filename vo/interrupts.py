"""Deferral of stop signals to the end of a frame."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def interrupts_between_frames() -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C to the next call of the yielded `check`; a second Ctrl-C takes effect at once.

    In the middle of a frame, an interrupt could leave the map inconsistent, and compiled code
    would turn it into another error. Other handled signals, such as SIGTERM, are deferred too.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None  # only the main thread receives signals
        return
    current = {number: signal.getsignal(number) for number in _STOPPING}
    handlers = {number: handler for number, handler in current.items() if callable(handler)}
    pending: list[int] = []

    def defer(number: int, frame: FrameType | None) -> None:
        if pending:
            handlers[signal.Signals(number)](number, frame)
        pending.append(number)

    def check() -> None:
        if pending:
            number = signal.Signals(pending[0])
            pending.clear()
            handlers[number](number, None)

    for number in handlers:
        signal.signal(number, defer)
    try:
        yield check
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
