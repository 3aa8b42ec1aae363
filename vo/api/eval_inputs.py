"""Inputs of `vo eval` that are not text: poses in logs, and ground truth of recordings."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from vo.base.errors import SourceError, VoError
from vo.outputs.evaluation.inputs import GivenTrajectory, Inputs, has_colour_of_kitti, load_inputs
from vo.recordings.sources.logs.log import Log
from vo.recordings.sources.logs.poses import (
    choose_pose_source,
    list_pose_sources,
    named_like_truth,
    read_poses,
)
from vo.recordings.sources.registry import FORMATS, detect_format, open_container, open_source

_log = logging.getLogger(__name__)
_ESTIMATE, _TRUTH = "estimate", "truth"


def read_inputs(
    estimate: Path | GivenTrajectory,
    reference: Path | GivenTrajectory,
    *,
    topics: Sequence[str] = (),
    calibration: Path | None = None,
    all_segments: bool = False,
) -> Inputs:
    """Read both trajectories; each may be text, a log, or the folder of a run or recording.

    Topics are of poses in logs: `estimate=TOPIC`, `truth=TOPIC`, or one name if only one is a log;
    others are as in `load_inputs`.

    Raises:
        VoError: a trajectory is missing, damaged or ambiguous.
    """
    is_log = {_ESTIMATE: _log_format(estimate) != "", _TRUTH: _log_format(reference) != ""}
    named = _parse(topics, [side for side, has_topics in is_log.items() if has_topics])
    given = estimate
    if isinstance(estimate, Path) and is_log[_ESTIMATE]:
        given = _poses_of_log(estimate, _ESTIMATE, named.get(_ESTIMATE))
    if isinstance(reference, GivenTrajectory):
        return load_inputs(given, reference, all_segments=all_segments)
    if is_log[_TRUTH]:
        truth = truth_of_log(reference, named.get(_TRUTH), calibration)
        return load_inputs(given, truth, all_segments=all_segments)
    if not has_colour_of_kitti(reference):
        try:
            return load_inputs(given, reference, calibration=calibration, all_segments=all_segments)
        except SourceError:
            if not _is_recording(reference):
                raise
    found = open_source(reference, calibration=calibration).ground_truth
    if found is None:
        raise SourceError(f"{reference} contains no ground truth; give a trajectory file")
    return load_inputs(given, GivenTrajectory(found, reference), all_segments=all_segments)


def truth_of_log(path: Path, named: str | None, calibration: Path | None) -> GivenTrajectory:
    """Ground truth of a log: of the camera if the log has one, else the poses as logged.

    Raises:
        SourceError: there are no poses, or several that can be meant.
    """
    is_of_frames = named is not None and ":" in named
    if not is_of_frames:
        topics = () if named is None else (f"truth={named}",)
        try:
            truth = open_source(path, calibration=calibration, topics=topics).ground_truth
        except VoError as error:
            _log.debug("%s: no ground truth of a camera: %s", path, error)
        else:
            if truth is not None:
                return GivenTrajectory(truth, path)
            if named is None:
                _refuse_odometry_as_truth(path)
    return _poses_of_log(path, _TRUTH, named)


def _refuse_odometry_as_truth(path: Path) -> None:
    """Refuse poses of a log with a camera that are not named like ground truth.

    Raises:
        SourceError: there are no others.
    """
    sources = list_pose_sources(open_container(path, _log_format(path)))
    if any(named_like_truth(each.name) for each in sources):
        return
    advice = f"choose poses with `topics=truth={sources[0].name}`, or " if sources else ""
    raise SourceError(f"{path} contains no ground truth; {advice}give a trajectory file")


def is_log(path: Path) -> bool:
    """Whether it is a file or folder of a log with topics."""
    return _log_format(path) != ""


def _poses_of_log(path: Path, role: str, named: str | None) -> GivenTrajectory:
    log: Log = open_container(path, _log_format(path))
    source = choose_pose_source(log, role, named)
    poses = read_poses(log, source)
    of_child = f" of frame '{poses.child}'" if poses.child else ""
    note = f"{role}: poses{of_child} on {source.name} of {path}, as logged"
    if role == _TRUTH:
        note += "; not moved to the camera, whose pose on the body is unknown"
    return GivenTrajectory(poses.trajectory, path, (note,))


def _parse(options: Sequence[str], logs: Sequence[str]) -> dict[str, str]:
    """Topics by side, `estimate` or `truth`."""
    named: dict[str, str] = {}
    for option in options:
        if not logs:
            raise SourceError(f"`topics={option}`: neither input is a log, so there are no topics")
        side, equals, name = option.partition("=")
        if not equals:
            side, name = (logs[0] if len(logs) == 1 else ""), option
        if side not in (_ESTIMATE, _TRUTH) or not name:
            raise SourceError(
                f"`topics={option}`: say whose poses these are, `topics=estimate=TOPIC` or "
                "`topics=truth=TOPIC`"
            )
        if side not in logs:
            raise SourceError(f"`topics={option}`: the {side} is not a log, so it has no topics")
        if side in named:
            raise SourceError(f"`topics` gives two topics for the {side}: {named[side]} and {name}")
        named[side] = name
    return named


def _log_format(path: Path | GivenTrajectory) -> str:
    """The format of a log; empty for anything else, such as the folder of a run."""
    if isinstance(path, GivenTrajectory):
        return ""
    names = ("trajectory.tum", "trajectory.tum.partial")
    if not path.exists() or any((path / name).is_file() for name in names):
        return ""
    try:
        name = detect_format(path)
    except (SourceError, OSError):
        return ""
    return name if FORMATS[name].has_topics else ""


def _is_recording(path: Path) -> bool:
    try:
        return path.exists() and bool(detect_format(path))
    except (SourceError, OSError):
        return False
