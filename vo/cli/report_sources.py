"""What a report takes from the recording that a run was made of: truth and images."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vo.errors import EvaluationError, SourceError, VoError
from vo.evaluation.inputs import Inputs, inputs_against, load_inputs
from vo.evaluation.report import Evaluation, evaluate
from vo.report.entry import Thumbnail
from vo.report.events import choose_events, shrink
from vo.report.run_folder import RunRecord
from vo.sources.registry import open_source
from vo.sources.source import Source
from vo.types import Mode, Trajectory

_NS_PER_S = 1e9


class Judged(NamedTuple):
    """A run against its truth, and where that came from; or why there is none."""

    evaluation: Evaluation | None
    truth: Trajectory | None
    origin: str
    notes: tuple[str, ...] = ()
    others: tuple[Evaluation, ...] = ()
    causal_ate_m: float | None = None


def open_recording(run: RunRecord) -> tuple[Source | None, str]:
    """The recording that a run was made of, or None; and why there is no truth if there is none."""
    path = Path(str(run.summary["source"]))
    mode: Mode = "mono" if run.summary["mode"] == "mono" else "auto"
    try:
        source = open_source(
            path,
            format=str(run.summary["format"]),
            calibration=run.summary.get("calibration"),
            mode=mode,
            topics=run.summary.get("topics", ()),
        )
    except VoError as error:
        return None, f"the recording cannot be read any more: {error}"
    return source, "the recording has none"


def judge(run: RunRecord, truth: Path | None, source: Source | None, why_not: str) -> Judged:
    """Compare a run with the truth that was asked for, or else with its recording's own.

    Raises:
        SourceError: the truth that was asked for is missing or damaged.
        EvaluationError: it cannot be compared with the run.
    """
    if not len(run.trajectory):
        return Judged(None, None, "nothing to compare: no frame has a pose")
    if truth is not None:
        return _compared(run, _inputs_asked(run, truth))
    path = Path(str(run.summary["source"]))
    try:
        inputs = _inputs_found(run, path, source)
        if inputs is None:
            return Judged(None, None, f"no truth: {why_not}")
        return _compared(run, inputs)
    except EvaluationError as error:
        return Judged(None, None, f"not compared with the recording's truth: {error}")


def _inputs_asked(run: RunRecord, truth: Path) -> Inputs:
    """A file or folder that `vo eval` knows, or any recording that has a truth."""
    if truth.is_file():
        return load_inputs(run.path, truth)
    inputs = _inputs_found(run, truth, open_source(truth))
    if inputs is None:
        raise SourceError(f"{truth} has no ground truth; give its file")
    return inputs


def _inputs_found(run: RunRecord, path: Path, source: Source | None) -> Inputs | None:
    """The truth that `vo eval` would take from a recording, or that the source brings along."""
    if path.is_dir():
        try:
            return load_inputs(run.path, path)
        except SourceError:
            pass
    if source is None or source.ground_truth is None:
        return None
    return inputs_against(run.path, source.ground_truth, path)


def _compared(run: RunRecord, inputs: Inputs) -> Judged:
    evaluation = evaluate(inputs.estimate, inputs.reference, mode=inputs.mode)
    origin = f"compared with the truth in {inputs.reference_path}"
    notes = (*inputs.notes, *evaluation.notes)
    others = _others(run, inputs)
    if others:
        notes = (*notes, "in the figures the other segments are aligned each by itself")
    causal_ate_m = _causal_ate_m(run, inputs)
    return Judged(evaluation, inputs.reference, origin, notes, others, causal_ate_m)


def _others(run: RunRecord, inputs: Inputs) -> tuple[Evaluation, ...]:
    """Segments that `inputs` leaves out, as far as they can be compared."""
    stamps_ns, judged = run.trajectory.stamps_ns, inputs.estimate.stamps_ns
    numbers = run.segment_of(stamps_ns)
    numbers[np.isin(stamps_ns, judged)] = -1
    found = []
    for number in np.unique(numbers[numbers >= 0]):
        rows = numbers == number
        segment = Trajectory(stamps_ns[rows], run.trajectory.world_from_cam[rows])
        with suppress(EvaluationError):
            found.append(evaluate(segment, inputs.reference, mode=inputs.mode))
    return tuple(found)


def _causal_ate_m(run: RunRecord, inputs: Inputs) -> float | None:
    """The same for the path as it was known at the time; None where that cannot be compared."""
    stamps_ns, judged = run.causal.stamps_ns, inputs.estimate.stamps_ns
    kept = (stamps_ns >= judged[0]) & (stamps_ns <= judged[-1])
    if not kept.any():
        return None
    causal = Trajectory(stamps_ns[kept], run.causal.world_from_cam[kept])
    try:
        evaluation = evaluate(causal, inputs.reference, mode=inputs.mode)
    except EvaluationError:
        return None
    return evaluation.ate.translation.rmse


def take_thumbnails(run: RunRecord, source: Source, zero_ns: int) -> tuple[Thumbnail, ...]:
    """Small images of frames where something happened; those that cannot be read are left out."""
    if run.frames is None:
        return ()
    thumbnails = []
    for row, event in choose_events(run.frames):
        number, stamp_ns = int(run.frames.frame[row]), int(run.frames.stamp_ns[row])
        try:
            frame = next(source.frames(number, number + 1), None)
        except VoError:
            continue
        if frame is not None and frame.stamp_ns == stamp_ns:
            seconds = (stamp_ns - zero_ns) / _NS_PER_S
            thumbnails.append(Thumbnail(number, seconds, event, shrink(frame.image0)))
    return tuple(thumbnails)
