"""The process of one job: `vo.runs.batch.execution` starts it and reads what it leaves.

The first line of standard input is the request. The pipe stays open as long as the batch lives;
when it closes, because the batch was killed or its machine is gone, the process ends at once.
"""

from __future__ import annotations

import json
import logging
import os
import resource
import signal
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vo.base.errors import EvaluationError, VoError
from vo.base.option_names import Flag, with_flags
from vo.base.printable import one_line
from vo.base.types import Trajectory
from vo.outputs.results.folder import write_atomically
from vo.runs.batch.job import Job, JobResult, JobStatus

if TYPE_CHECKING:
    from vo.outputs.evaluation.inputs import GivenTrajectory, Inputs

RESULT = "result.json"
_STDIN = 0
_ABANDONED = 75  # exit status after the end of the batch


def main() -> None:
    """Run the job of the request on standard input."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # workers of Ray block it
    request = json.loads(_first_line())
    threading.Thread(target=_end_with_batch, daemon=True).start()
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    limit_mb = request["memory_mb"]
    if limit_mb is not None:
        limit = int(limit_mb) << 20
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    job, folder = Job.from_dict(request["job"]), Path(request["folder"])
    flags = {name: Flag(*values) for name, values in request["flags"].items()}
    result = run_job_here(job, folder, int(request["threads"]), flags)
    write_result(folder, result)


# Standard input is read without Python's buffer, whose lock would be held at the end.
def _first_line() -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        part = os.read(_STDIN, 1 << 16)
        if not part:
            os._exit(_ABANDONED)
        line += part
    return line


def _end_with_batch() -> None:
    while os.read(_STDIN, 1 << 10):
        pass
    os._exit(_ABANDONED)


def run_job_here(job: Job, folder: Path, threads: int, flags: Mapping[str, Flag]) -> JobResult:
    """Run a job in this process, writing to a folder; errors of the run are results."""
    failed = JobResult(job.name, job.source, JobStatus.FAILED, tags=job.tags)
    try:
        return _run(job, folder, threads, flags)
    except VoError as found:
        return replace(failed, error=with_flags(one_line(str(found)), flags))
    except MemoryError:
        error = "it needs more memory than the batch allows (`memory_mb`)"
        return replace(failed, error=with_flags(error, flags))
    except OSError as found:
        where = "" if found.filename is None else f"{found.filename}: "
        return replace(failed, error=one_line(f"{where}{found.strerror or found}"))


def write_result(folder: Path, result: JobResult) -> None:
    """Write `result.json` at once.

    Raises:
        OutputError: it cannot be written.
    """
    text = json.dumps(result.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(folder / RESULT, text)


def _run(job: Job, folder: Path, threads: int, flags: Mapping[str, Flag]) -> JobResult:
    from vo.base.config import load_config
    from vo.runs.batch.fingerprint import fingerprint
    from vo.runs.batch.object_store import local_copy
    from vo.runs.run_recording import run

    config = load_config(job.config, [*job.overrides, f"threads={threads}"])
    identity = fingerprint(job, config)
    with local_copy(job.source) as source:
        summary = run(
            source,
            folder,
            config=config,
            start=job.start,
            end=job.end,
            stride=job.stride,
            source_name=None if source == job.source else job.source,
            flags=flags,
            **_reading(job),
        )
        errors, notes = _errors(job, source, folder)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    frames = summary.frames
    return JobResult(
        job.name,
        job.source,
        JobStatus.DONE,
        fingerprint=identity,
        tags=job.tags,
        verdict=summary.verdict.word,
        trusted=summary.verdict.is_trusted,
        frames=frames,
        tracked_ratio=(summary.tracked + summary.interpolated) / frames if frames else 0.0,
        segments=len(summary.segments),
        path_m=summary.path_m,
        length_unit=summary.length_unit,
        **errors,
        wall_s=summary.wall_s,
        cpu_s=round(sum(each.ru_utime + each.ru_stime for each in used), 3),
        frames_per_s=round(summary.frames_per_s, 3),
        peak_rss_mb=summary.peak_rss_mb,
        warnings=tuple(with_flags(text, flags) for text in (*summary.warnings, *notes)),
    )


def _errors(job: Job, source: str, folder: Path) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Errors of a `JobResult` by name, empty without ground truth; and remarks."""
    from vo.outputs.evaluation.association import tracked_part
    from vo.outputs.evaluation.evaluation import evaluate
    from vo.outputs.evaluation.inputs import causal_ate_m
    from vo.recordings.formats.trajectory import read_tum

    try:
        inputs = _inputs(job, source, folder)
        if inputs is None:
            return {}, ()
        evaluation = evaluate(inputs.estimate, inputs.reference, mode=inputs.mode)
    except EvaluationError as error:
        return {}, (f"not compared with the ground truth: {error}",)
    drift = evaluation.segments
    causal = tracked_part(read_tum(folder / "causal.tum"), folder)
    return {
        "ate_m": evaluation.ate.translation.rmse,
        "causal_ate_m": causal_ate_m(causal, inputs),
        "drift_percent": None if drift is None else drift.translation_percent,
        "drift_deg_per_100m": None if drift is None else 100.0 * drift.rotation_deg_per_m,
    }, ()


def _inputs(job: Job, source: str, folder: Path) -> Inputs | None:
    """The path of a run and its ground truth; None without one."""
    from vo.outputs.evaluation.inputs import inputs_with_own_truth, load_inputs

    if job.truth is None:
        return inputs_with_own_truth(folder, Path(source), _truth_of(job, source))
    if job.is_truth_of_body:
        return load_inputs(folder, _truth_of_body(Path(job.truth), job.calibration))
    return load_inputs(folder, Path(job.truth))


def _truth_of_body(file: Path, calibration: str | None) -> GivenTrajectory:
    """Poses of the body in a file, moved to cam0 by the calibration if that has its pose."""
    from vo.outputs.evaluation.inputs import GivenTrajectory
    from vo.recordings.formats.calibration import read_calibration
    from vo.recordings.formats.trajectory import read_trajectory

    truth = read_trajectory(file)
    body_from_cam0 = None if calibration is None else read_calibration(calibration).body_from_cam0
    if body_from_cam0 is None:
        return GivenTrajectory(truth, file)
    poses = truth.world_from_cam @ body_from_cam0
    return GivenTrajectory(replace(truth, world_from_cam=poses), file)


def _truth_of(job: Job, source: str) -> Trajectory | None:
    from vo.recordings.sources.registry import open_source

    return open_source(source, **_reading(job)).ground_truth


def _reading(job: Job) -> dict[str, Any]:
    """How the recording is read, for the run and for its ground truth."""
    return {
        "format": job.format,
        "calibration": None if job.calibration is None else Path(job.calibration),
        "mode": job.mode,
        "topics": job.topics,
        "right_offset_ns": job.right_offset_ns,
        "side_by_side": job.side_by_side,
    }
