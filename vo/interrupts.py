"""When signals that would end a run take effect."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def interrupts_between_frames() -> Iterator[Callable[[], None]]:
    """Ctrl-C waits until the frame in hand is done and `check` is called; a second one does not.

    In the middle of a frame it could leave the map half changed, and compiled code answers it
    with an error of its own. So do other signals that the program answers, such as SIGTERM.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None  # signals reach the main thread only
        return
    handlers = {number: signal.getsignal(number) for number in _STOPPING}
    answers = {number: answer for number, answer in handlers.items() if callable(answer)}
    asked: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        if asked:
            answers[signal.Signals(number)](number, frame)
        asked.append(number)

    def check() -> None:
        if asked:
            number = signal.Signals(asked[0])
            asked.clear()
            answers[number](number, None)

    for number in answers:
        signal.signal(number, note)
    try:
        yield check
    finally:
        for number, answer in answers.items():
            signal.signal(number, answer)
