"""Deferral of stop signals: to the end of a frame, and for good while results are saved."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

_STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_log = logging.getLogger(__name__)


class DeferredInterrupts:
    """Stop signals of a run, such as Ctrl-C.

    While frames are tracked, signals wait for `check`, because in the middle of a frame they could
    leave the map inconsistent, and an exception inside a callback of compiled code ends the
    process. Only inside `waiting`, where a source may wait for a frame forever, or an output for
    its reader, they take effect at once: of a source the second one, of an output the first. Once a
    signal is delivered, or after `close`, signals have no effect but a message: what was computed
    is being saved, and nothing may cost results.

    A live source has no end of its own: there the first signal is the usual end (`end_gently`).
    """

    def __init__(self) -> None:
        self.handlers: dict[int, signal._HANDLER] = {}
        self._pending: list[int] = []
        self._is_closing = False
        self._is_explained = False
        self._needed: int | None = None  # signals that take effect at once
        self._stop: Callable[[], None] | None = None

    def end_gently(self, stop: Callable[[], None]) -> None:
        """Let the first signal call a function that ends the run, as if it were finished."""
        self._stop = stop

    @contextmanager
    def waiting(self, *, signals: int = 2) -> Iterator[None]:
        """Deliver a signal at once inside this block, if it is the second, or of another number."""
        self._needed = signals
        try:
            yield
        finally:
            self._needed = None

    def check(self) -> None:
        """Deliver a signal that has arrived."""
        if self._pending and not self._is_closing:
            self._deliver(self._pending[0], None)

    def close(self) -> None:
        """Deliver no more signals."""
        self._is_closing = True

    def receive(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if self._is_closing:
            self._explain_once()
            return
        if self._stop is not None:
            stop, self._stop = self._stop, None
            stop()
            return
        self._pending.append(number)
        if self._needed is not None and len(self._pending) >= self._needed:
            self._deliver(number, frame)

    def _explain_once(self) -> None:
        if not self._is_explained:
            self._is_explained = True
            with suppress(RuntimeError):  # the signal came while a message was being written
                _log.warning("the results are being saved, which cannot be interrupted")

    def _deliver(self, number: int, frame: FrameType | None) -> None:
        # Before the handler raises: no further signal may interrupt the saving of results.
        self._is_closing = True
        handler = self.handlers[number]
        assert callable(handler)
        handler(number, frame)


@contextmanager
def deferred_interrupts() -> Iterator[DeferredInterrupts]:
    """Defer stop signals inside this block; ignored ones, as under nohup, remain ignored.

    Signals that were never delivered are dropped at the end. Outside of the main thread, which
    alone receives signals, nothing is changed.
    """
    interrupts = DeferredInterrupts()
    if threading.current_thread() is threading.main_thread():
        current = {number: signal.getsignal(number) for number in _STOPPING}
        interrupts.handlers = {n: handler for n, handler in current.items() if callable(handler)}
    for number in interrupts.handlers:
        signal.signal(number, interrupts.receive)
    try:
        yield interrupts
    finally:
        for number, handler in interrupts.handlers.items():
            signal.signal(number, handler)
