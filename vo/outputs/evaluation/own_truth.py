"""Evaluation of a run: against the ground truth of its recording, and of its causal path."""

from __future__ import annotations

from pathlib import Path

from vo.base.errors import EvaluationError, SourceError
from vo.base.types import Trajectory
from vo.outputs.evaluation.inputs import GivenTrajectory, Inputs, load_inputs
from vo.outputs.evaluation.report import evaluate


def has_colour_of_kitti(path: Path) -> bool:
    """Whether it is a sequence of KITTI with the colour cameras alone.

    Its poses.txt is that of the grey left camera, and only the recording can move it.
    """
    return (path / "image_2").is_dir() and not (path / "image_0").is_dir()


def inputs_with_own_truth(run: Path, recording: Path, truth: Trajectory | None) -> Inputs | None:
    """A run and the ground truth of its recording: from its file, or else as opened.

    `truth`: ground truth of the opened recording, None without one.

    Returns None without ground truth.

    Raises:
        EvaluationError: the two cannot be compared.
    """
    if recording.is_dir() and not has_colour_of_kitti(recording):
        try:
            return load_inputs(run, recording)
        except SourceError:
            pass
    return None if truth is None else load_inputs(run, GivenTrajectory(truth, recording))


def causal_ate_m(causal: Trajectory, inputs: Inputs) -> float | None:
    """ATE of the part of the causal path that belongs to an estimate; None if there is none.

    `causal`: the whole causal path of the run, of tracked frames. `inputs`: the smoothed path of a
    segment, and the ground truth.
    """
    stamps_ns, evaluated_ns = causal.stamps_ns, inputs.estimate.stamps_ns
    kept = (stamps_ns >= evaluated_ns[0]) & (stamps_ns <= evaluated_ns[-1])
    if not kept.any():
        return None
    path = Trajectory(stamps_ns[kept], causal.world_from_cam[kept])
    try:
        return evaluate(path, inputs.reference, mode=inputs.causal_mode).ate.translation.rmse
    except EvaluationError:
        return None
