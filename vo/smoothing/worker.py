"""What runs in the smoother's process: windows come in, adjusted windows go out."""

from __future__ import annotations

import os
import signal
import traceback
from typing import IO

from vo.smoothing.messages import receive, send
from vo.smoothing.solution import WindowSolution, smooth


def main() -> None:
    """Answer on standard output what comes on standard input, until that is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    questions = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not get among the answers
    try:
        serve(questions, answers)
    except (EOFError, BrokenPipeError):
        os._exit(0)  # nobody asks any more; what is buffered has no reader


def serve(questions: IO[bytes], answers: IO[bytes]) -> None:
    """Answer windows with adjusted windows, or with the text of what went wrong.

    Raises:
        EOFError: there are no more questions.
        BrokenPipeError: nobody waits for the answer.
    """
    while True:
        problem, config = receive(questions)
        answer: WindowSolution | str
        try:
            answer = smooth(problem, config)
        except Exception:
            answer = traceback.format_exc()
        send(answers, answer)
