"""Parts of a report that are read from the recording of the run: ground truth and images."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.api.eval_inputs import is_log, truth_of_log
from vo.base.errors import EvaluationError, SourceError, VoError
from vo.base.types import Mode, Trajectory, with_image0
from vo.outputs.evaluation.association import tracked_part
from vo.outputs.evaluation.evaluation import Evaluation, evaluate
from vo.outputs.evaluation.inputs import Inputs, causal_ate_m, inputs_with_own_truth, load_inputs
from vo.outputs.report.entry import Thumbnail
from vo.outputs.report.run_folder import RunRecord
from vo.outputs.report.sections import choose_events, shrink
from vo.recordings.sources.registry import open_source
from vo.recordings.sources.source import Recording

_NS_PER_S = 1e9


class EvaluatedRun(NamedTuple):
    """Evaluation of the longest segment of a run and of others, if there is ground truth.

    Otherwise `origin` says why not. The causal error is without poses that were only predicted.
    """

    evaluation: Evaluation | None
    truth: Trajectory | None
    origin: str
    notes: tuple[str, ...] = ()
    others: tuple[Evaluation, ...] = ()
    causal_ate_m: float | None = None


def open_recording(run: RunRecord) -> tuple[Recording | None, str]:
    """The recording of a run, or None; and the reason to report if there is no ground truth."""
    path = Path(str(run.summary["source"]))
    mode: Mode = "mono" if run.summary["mode"] == "mono" else "auto"
    try:
        source = open_source(
            path,
            format=str(run.summary["format"]),
            calibration=run.summary.get("calibration"),
            mode=mode,
            topics=run.summary.get("topics", ()),
            right_offset_ns=run.summary.get("right_offset_ns"),
        )
    except VoError as error:
        return None, f"the recording can no longer be read: {error}"
    return source, "the recording contains none"


def evaluate_run(
    run: RunRecord, truth: Path | None, source: Recording | None, why_no_truth: str
) -> EvaluatedRun:
    """Evaluate a run against the given ground truth, by default that of its recording.

    Raises:
        SourceError: the given ground truth is missing or damaged.
        EvaluationError: the given ground truth cannot be compared with the run.
    """
    if not len(run.trajectory):
        return EvaluatedRun(None, None, "nothing to compare: no frame has a pose")
    if truth is not None:
        return _evaluated(run, _inputs_with_given_truth(run, truth))
    path = Path(str(run.summary["source"]))
    try:
        inputs = inputs_with_own_truth(
            run.path, path, None if source is None else source.ground_truth
        )
        if inputs is None:
            return EvaluatedRun(None, None, f"no ground truth: {why_no_truth}")
        return _evaluated(run, inputs)
    except EvaluationError as error:
        return EvaluatedRun(
            None, None, f"not compared with the ground truth of the recording: {error}"
        )


def _inputs_with_given_truth(run: RunRecord, truth: Path) -> Inputs:
    """Inputs from a ground truth file, or from any recording with ground truth."""
    if is_log(truth):
        return load_inputs(run.path, truth_of_log(truth, None, None))
    if truth.is_file():
        return load_inputs(run.path, truth)
    inputs = inputs_with_own_truth(run.path, truth, open_source(truth).ground_truth)
    if inputs is None:
        raise SourceError(f"{truth} contains no ground truth; give a trajectory file")
    return inputs


def _evaluated(run: RunRecord, inputs: Inputs) -> EvaluatedRun:
    evaluation = evaluate(inputs.estimate, inputs.reference, mode=inputs.mode)
    origin = f"compared with the ground truth in {inputs.reference_path}"
    notes = (*inputs.notes, *evaluation.notes)
    others = _others(run, inputs)
    if others:
        notes = (*notes, "in the figures, each of the other segments is aligned separately")
    causal = causal_ate_m(tracked_part(run.causal, run.path), inputs)
    if causal is not None and inputs.mode != inputs.causal_mode:
        notes = (*notes, "the causal path had no scale when it was tracked: aligned by sim3")
    return EvaluatedRun(evaluation, inputs.reference, origin, notes, others, causal)


def _others(run: RunRecord, inputs: Inputs) -> tuple[Evaluation, ...]:
    """Evaluations of the segments left out of `inputs`, where possible."""
    stamps_ns, evaluated_ns = run.trajectory.stamps_ns, inputs.estimate.stamps_ns
    numbers = run.segment_of(stamps_ns)
    numbers[np.isin(stamps_ns, evaluated_ns)] = -1
    found = []
    for number in np.unique(numbers[numbers >= 0]):
        rows = numbers == number
        segment = Trajectory(stamps_ns[rows], run.trajectory.world_from_cam[rows])
        with suppress(EvaluationError):
            found.append(evaluate(segment, inputs.reference, mode=inputs.mode))
    return tuple(found)


def take_thumbnails(run: RunRecord, source: Recording, zero_ns: int) -> tuple[Thumbnail, ...]:
    """Small images of frames with events; unreadable frames are left out."""
    if run.frames is None:
        return ()
    thumbnails = []
    for row, event in choose_events(run.frames):
        number, stamp_ns = int(run.frames.frame[row]), int(run.frames.stamp_ns[row])
        try:
            frame = next(with_image0(source.frames(number, number + 1)), None)
        except VoError:
            continue
        if frame is not None and frame.stamp_ns == stamp_ns:
            seconds = (stamp_ns - zero_ns) / _NS_PER_S
            thumbnails.append(Thumbnail(number, seconds, event, shrink(frame.image0)))
    return tuple(thumbnails)
