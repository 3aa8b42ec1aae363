"""Main loop of a solver's process: receives problems, sends their solutions."""

from __future__ import annotations

import gc
import os
import traceback
from typing import IO

from vo.base.scheduling import give_way
from vo.engine.backend.messages import receive, send


def main() -> None:
    """Read problems from standard input and write solutions to standard output, until it closes."""
    problems = os.fdopen(os.dup(0), "rb")
    solutions = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of libraries must not get between the solutions
    give_way()
    gc.freeze()  # loaded modules are no garbage
    gc.enable()
    try:
        serve(problems, solutions)
    except (EOFError, BrokenPipeError):
        os._exit(0)  # the reader is gone: buffered output is dropped


def serve(problems: IO[bytes], solutions: IO[bytes]) -> None:
    """Send the solution of each problem, or the text of an error.

    Raises:
        EOFError: there are no more problems.
        BrokenPipeError: the reader is gone.
    """
    while True:
        solver, problem = receive(problems)
        solution: object
        try:
            solution = solver(problem)
        except Exception:
            solution = traceback.format_exc()
        send(solutions, solution)
