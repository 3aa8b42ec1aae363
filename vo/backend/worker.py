"""What runs in the smoother's process: windows come in, adjusted windows go out."""

from __future__ import annotations

import gc
import os
import traceback
from types import SimpleNamespace
from typing import IO, Any

import numpy as np

from vo.backend.messages import receive, send
from vo.backend.solution import WindowSolution, smooth
from vo.scheduling import give_way
from vo.types import WindowProblem


def main() -> None:
    """Answer on standard output what comes on standard input, until that is closed."""
    questions = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not get among the answers
    warm_up()
    give_way()
    gc.freeze()  # what is loaded stays
    gc.enable()
    try:
        serve(questions, answers)
    except (EOFError, BrokenPipeError):
        os._exit(0)  # nobody asks any more; what is buffered has no reader


def warm_up() -> None:
    """Load compiled code while the recording is opened, not when the first window waits for it."""
    across = np.array([-1.0, 0.0, 1.0])
    points = np.stack([across, across[[1, 2, 0]], np.full(3, 5.0)], axis=1)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 0.1
    in_cam = np.concatenate([points - pose[:3, 3] for pose in poses])
    problem = WindowProblem(
        intrinsics=(500.0, 500.0, 320.0, 240.0),
        baseline_m=0.1,
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
        sigma_disparity_px=0.4,
        covariance_scale=1.0,
    )
    smooth(problem, options)


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
