"""Evaluation of a run against the ground truth that its recording contains."""

from __future__ import annotations

from pathlib import Path

from vo.errors import SourceError
from vo.evaluation.inputs import GivenTrajectory, Inputs, load_inputs
from vo.types import Trajectory


def has_colour_of_kitti(path: Path) -> bool:
    """Whether it is a sequence of KITTI with the colour cameras alone.

    Its poses.txt is that of the grey left camera, and only the recording can move it.
    """
    return (path / "image_2").is_dir() and not (path / "image_0").is_dir()


def inputs_with_own_truth(run: Path, recording: Path, truth: Trajectory | None) -> Inputs | None:
    """A run and the ground truth of its recording: from its file, or else as opened.

    Args:
        run: folder of the run.
        recording: path of the recording.
        truth: ground truth of the opened recording, None without one.

    Returns:
        None without ground truth.

    Raises:
        EvaluationError: the two cannot be compared.
    """
    if recording.is_dir() and not has_colour_of_kitti(recording):
        try:
            return load_inputs(run, recording)
        except SourceError:
            pass
    return None if truth is None else load_inputs(run, GivenTrajectory(truth, recording))
