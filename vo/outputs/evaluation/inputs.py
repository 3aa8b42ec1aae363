"""Inputs of an evaluation: two comparable trajectories from files or folders."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vo.base.errors import CalibrationError, EvaluationError, SourceError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.base.types import Mode, Trajectory
from vo.outputs.evaluation.association import frame_numbers, predicted, segment_numbers
from vo.outputs.evaluation.evaluation import evaluate
from vo.recordings.formats.calibration import Calibration, read_calibration
from vo.recordings.formats.euroc_layout import find_camera_on_body
from vo.recordings.formats.trajectory import detect_format, has_stamps, read_trajectory

_ESTIMATE_NAMES = (
    "trajectory.tum",
    "trajectory.tum.partial",
)  # the latter is written until a run ends
_CAUSAL_NAMES = ("causal.tum", "causal.tum.partial")
_REFERENCE_NAMES = (
    "groundtruth.tum",
    "groundtruth.txt",
    "poses.txt",
    "mav0/state_groundtruth_estimate0/data.csv",
    "state_groundtruth_estimate0/data.csv",
    "mav0/mocap0/data.csv",
    "mav0/gt0/data.csv",
    "pose_left.txt",
    "pose_lcam_front.txt",
)
_SCALED_NOTE = "mono estimate in metres, by the scale in its summary.json: aligned without scale"
_RUN_NOTE = "the reference is another run: these are differences, not errors"
_UNSCALED_RUN_NOTE = "the reference run has no scale: lengths here are in its map units, not metres"
_TARTANAIR_NOTE = "ground truth read as TartanAir's: camera axes x forward, y right, z down"


@dataclass(frozen=True, eq=False)
class Inputs:
    """Two comparable trajectories and their origin."""

    estimate_path: Path
    reference_path: Path  # file or folder of the reference
    estimate: Trajectory
    reference: Trajectory
    mode: Mode  # mode of the run that made the estimate, `auto` if unknown
    notes: tuple[str, ...] = ()  # changes made to them, for the reader of the results
    # mode of the causal path of the run, which is never converted to metres
    causal_mode: Mode = "auto"

    @property
    def title(self) -> str:
        """Both files with their folders, as file names alone are ambiguous."""
        names = ["/".join(p.parts[-2:]) for p in (self.estimate_path, self.reference_path)]
        return f"{names[0]}  vs.  {names[1]}"


@dataclass(frozen=True, eq=False)
class GivenTrajectory:
    """A trajectory, its origin, and notes for the reader of the results.

    `has_stamps` is False for a text file of poses alone: its stamps are numbers of lines.
    """

    trajectory: Trajectory
    origin: Path
    notes: tuple[str, ...] = ()
    has_stamps: bool = True


def load_inputs(
    estimate: Path | str | GivenTrajectory,
    reference: Path | str | GivenTrajectory,
    *,
    calibration: Path | None = None,
    all_segments: bool = False,
) -> Inputs:
    """Read an estimate and its reference.

    `estimate`: a trajectory file, the folder of a run with `trajectory.tum` and `summary.json`, or
    a trajectory. `reference`: a trajectory file, the folder of a sequence with its ground truth, a
    trajectory, or the folder of another run, to compare both. `calibration`: file with the pose of
    cam0 on the body, for ground truth of the body; by default that of the run, or else the one
    beside the ground truth. `all_segments`: keep all segments of a run that lost track. Each has
    its own world frame, so by default only the longest is kept.

    Raises:
        SourceError: a file is missing or damaged.
        CalibrationError: the calibration is missing or damaged.
        EvaluationError: only one of them has stamps, and their numbers of poses differ.
    """
    if not isinstance(estimate, GivenTrajectory):
        estimate = _read_file(_estimate_file(Path(estimate)))
    summary = _summary_beside(estimate.origin)
    causal_notes = _causal_notes(estimate)
    if not isinstance(reference, GivenTrajectory) and summary and _is_run(Path(reference)):
        reference, summary = _other_run(Path(reference), summary)
    if not isinstance(reference, GivenTrajectory):
        reference = _read_reference(
            _reference_file(Path(reference)),
            _calibration_of_run(summary) if calibration is None else read_calibration(calibration),
        )
    mode, causal_mode = _modes(summary, estimate.origin)
    scaled = (_SCALED_NOTE,) if mode != causal_mode else ()
    inputs = Inputs(
        estimate.origin,
        reference.origin,
        estimate.trajectory,
        reference.trajectory,
        mode=mode,
        notes=(*scaled, *causal_notes, *estimate.notes, *reference.notes),
        causal_mode=causal_mode,
    )
    if estimate.has_stamps and not reference.has_stamps:
        inputs = _with_frame_numbers(inputs, summary)
    inputs = _with_common_stamps(inputs, not estimate.has_stamps, not reference.has_stamps)
    return inputs if all_segments else _with_longest_segment(inputs, summary)


def _estimate_file(path: Path) -> Path:
    if not path.is_dir():
        return path
    for name in _ESTIMATE_NAMES:
        if (path / name).is_file():
            return path / name
    raise SourceError(
        f"{path} has no trajectory.tum; give the folder of a run or a trajectory file"
    )


def _is_run(path: Path) -> bool:
    return any((path / name).is_file() for name in _ESTIMATE_NAMES)


def _other_run(path: Path, summary: dict[str, Any]) -> tuple[GivenTrajectory, dict[str, Any]]:
    """The longest segment of another run; the summary says `mono` if that run lacks a scale."""
    read = _read_file(_estimate_file(path))
    other = _summary_beside(read.origin)
    _, causal_mode = modes = _modes(other, read.origin)
    alone = Inputs(read.origin, read.origin, read.trajectory, read.trajectory, modes[0])
    kept = _with_longest_segment(alone, other)
    notes = (_RUN_NOTE, *(f"reference: {note}" for note in kept.notes))
    if modes[0] == causal_mode == "mono":
        summary = summary | {"mode": "mono", "length_unit": other.get("length_unit")}
        notes = (*notes, _UNSCALED_RUN_NOTE)
    return replace(read, trajectory=kept.estimate, notes=notes), summary


def _reference_file(path: Path) -> Path:
    if not path.is_dir():
        return path
    for name in _REFERENCE_NAMES:
        if (path / name).is_file():
            return path / name
    if _is_run(path):
        raise SourceError(
            f"{path} is the output of a run, not ground truth; give the run first, then the ground "
            "truth"
        )
    names = ", ".join(_REFERENCE_NAMES)
    raise SourceError(f"{path} has no ground truth (none of {names}); give its file")


def _summary_beside(estimate: Path) -> dict[str, Any]:
    """Summary of the run; empty if it is missing or damaged."""
    try:
        summary = load_json(read_text(estimate.with_name("summary.json")))
    except (OSError, ValueError):
        return {}
    return summary if isinstance(summary, dict) else {}


def _modes(summary: dict[str, Any], estimate: Path) -> tuple[Mode, Mode]:
    """Modes of the estimate and of the causal path; `auto` for a mono path in metres."""
    mode = summary.get("mode")
    if mode == "mono" or summary.get("length_unit") == "map units":
        is_smoothed = estimate.name in _ESTIMATE_NAMES
        return "auto" if is_smoothed and summary.get("length_unit") == "m" else "mono", "mono"
    known: Mode = "stereo" if mode == "stereo" else "auto"
    return known, known


def _causal_notes(estimate: GivenTrajectory) -> tuple[str, ...]:
    if estimate.origin.name not in _CAUSAL_NAMES:
        return ()
    count = np.count_nonzero(predicted(estimate.trajectory, estimate.origin.parent))
    if not count:
        return ()
    return (
        f"{count} of {len(estimate.trajectory)} poses are of lost frames, predicted by an inertial "
        "sensor; they are evaluated, too",
    )


def _calibration_of_run(summary: dict[str, Any]) -> Calibration | None:
    """The calibration file that a run was given, if it still exists and says its image size."""
    name = summary.get("calibration")
    if not isinstance(name, str):
        return None
    try:
        return read_calibration(Path(name))
    except CalibrationError:
        return None


def _read_file(path: Path) -> GivenTrajectory:
    return GivenTrajectory(read_trajectory(path), path, has_stamps=has_stamps(path))


def _read_reference(path: Path, calibration: Calibration | None) -> GivenTrajectory:
    """Ground truth of cam0; EuRoC's is that of the body, with T_BS = body_from_cam0."""
    read, kind = _read_file(path), detect_format(path)
    if kind == "tartanair":
        return replace(read, notes=(_TARTANAIR_NOTE,))
    if kind != "euroc":
        return read
    root = path.resolve().parent.parent
    found = find_camera_on_body(root, calibration)
    if found is None:
        note = (
            "ground truth taken as that of the camera: no cam0/sensor.yaml and no camchain.yaml "
            f"in {root} contains the camera's pose on the body; give it with `calibration=FILE`"
        )
        return replace(read, notes=(note,))
    poses = read.trajectory.world_from_cam @ found.body_from_cam0
    note = f"ground truth moved from the body to cam0, by its pose in {found.file}"
    return GivenTrajectory(replace(read.trajectory, world_from_cam=poses), path, (note,))


def _with_frame_numbers(inputs: Inputs, summary: dict[str, Any]) -> Inputs:
    """Keep the reference's poses of the frames that the run has a pose of, where that is known."""
    estimate, reference = inputs.estimate, inputs.reference
    if len(estimate) == len(reference):
        return inputs
    rows = frame_numbers(inputs.estimate_path, estimate.stamps_ns, summary, len(reference))
    if rows is None:
        return inputs
    kept = Trajectory(reference.stamps_ns[rows], reference.world_from_cam[rows])
    note = f"{len(rows)} of {len(reference)} poses of the ground truth, by the numbers of frames"
    return replace(inputs, reference=kept, notes=(*inputs.notes, note))


def _with_common_stamps(inputs: Inputs, estimate_bare: bool, reference_bare: bool) -> Inputs:
    """Pair poses row by row if only one file has stamps and both have the same number of poses."""
    if estimate_bare and reference_bare:
        note = "neither file has stamps: poses paired row by row, one per second"
        return replace(inputs, notes=(*inputs.notes, note))
    if estimate_bare == reference_bare:
        return inputs
    estimate, reference = inputs.estimate, inputs.reference
    if len(estimate) != len(reference):
        bare = inputs.estimate_path if estimate_bare else inputs.reference_path
        is_json = bare.suffix.lower() == ".json"
        raise EvaluationError(
            f"{bare} has no stamps and the numbers of poses differ ({len(estimate)} and "
            f"{len(reference)}); "
            + ("give its folder, with the images" if is_json else "put its times.txt beside it")
        )
    if estimate_bare:
        estimate = replace(estimate, stamps_ns=reference.stamps_ns)
    else:
        reference = replace(reference, stamps_ns=estimate.stamps_ns)
    notes = (*inputs.notes, "one file has no stamps: poses paired row by row")
    return replace(inputs, estimate=estimate, reference=reference, notes=notes)


def _with_longest_segment(inputs: Inputs, summary: dict[str, Any]) -> Inputs:
    segments = summary.get("segments")
    if not isinstance(segments, list) or len(segments) < 2:
        return inputs
    stamps_ns = inputs.estimate.stamps_ns
    try:
        spans = [(int(s["first_stamp_ns"]), int(s["last_stamp_ns"])) for s in segments]
    except (KeyError, TypeError, ValueError):
        return inputs
    masks = [(stamps_ns >= first) & (stamps_ns <= last) for first, last in spans]
    numbers = segment_numbers(inputs.estimate_path, stamps_ns)
    if numbers is not None and all("segment" in s for s in segments):
        masks = [numbers == s["segment"] for s in segments]
    kept = max(masks, key=np.count_nonzero)
    if not kept.any():
        return inputs
    note = (
        f"{len(segments)} segments, each with its own world frame: only the longest is evaluated, "
        f"{np.count_nonzero(kept)} of {len(stamps_ns)} poses (all of them: `all_segments`)"
    )
    estimate = Trajectory(stamps_ns[kept], inputs.estimate.world_from_cam[kept])
    return replace(inputs, estimate=estimate, notes=(*inputs.notes, note))


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
