"""Main loop of a solver's process: receives problems, sends their solutions."""

from __future__ import annotations

import gc
import os
import traceback
from types import SimpleNamespace
from typing import IO, Any

import numpy as np

from vo.base.geometry.projection import Intrinsics
from vo.base.scheduling import give_way
from vo.engine.backend.messages import receive, send
from vo.engine.backend.solution import solve
from vo.engine.backend.window_problem import WindowProblem


def main(for_windows: bool) -> None:
    """Read problems from standard input and write solutions to standard output, until it closes."""
    problems = os.fdopen(os.dup(0), "rb")
    solutions = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of libraries must not get between the solutions
    if for_windows:
        warm_up()
    give_way()
    gc.freeze()  # loaded modules are no garbage
    gc.enable()
    try:
        serve(problems, solutions)
    except (EOFError, BrokenPipeError):
        os._exit(0)  # the reader is gone: buffered output is dropped


def warm_up() -> None:
    """Load compiled code while the recording is opened, not when the first window waits for it."""
    across = np.array([-1.0, 0.0, 1.0])
    points = np.stack([across, across[[1, 2, 0]], np.full(3, 5.0)], axis=1)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 0.1
    in_cam = np.concatenate([points - pose[:3, 3] for pose in poses])
    problem = WindowProblem(
        intrinsics=Intrinsics(500.0, 500.0, 320.0, 240.0),
        baseline_m=0.1,
        sigma_disparity_px=0.4,
        world_from_cam=poses,
        fixed=np.array([True, False]),
        points=points,
        keyframe=np.repeat(np.arange(2), 3),
        point=np.tile(np.arange(3), 2),
        xy=500.0 * in_cam[:, :2] / in_cam[:, 2:] + (320.0, 240.0),
        disparity=50.0 / in_cam[:, 2],
        sigma_px=np.ones(6),
    )
    options: Any = SimpleNamespace(
        iterations=8,
        relative_error_tolerance=1e-3,
        huber=1.0,
        covariance_scale=1.0,
    )
    solve(problem, options)


def serve(problems: IO[bytes], solutions: IO[bytes]) -> None:
    """Send the solution of each problem, or the text of an error.

    Raises:
        EOFError: there are no more problems.
        BrokenPipeError: the reader is gone.
    """
    while True:
        solver, *arguments = receive(problems)
        solution: object
        try:
            solution = solver(*arguments)
        except Exception:
            solution = traceback.format_exc()
        send(solutions, solution)
