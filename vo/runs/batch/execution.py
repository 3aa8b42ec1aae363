"""Runs a job in a process of its own, and moves finished results to their final name.

Results appear under their name only when they are complete. An input error costs one attempt; a
process that crashes or takes too long is started again, up to a number of times.
"""

from __future__ import annotations

import json
import logging
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import mkdtemp
from typing import IO

from vo.base.compiling.processor import use_common_instructions
from vo.base.config import load_config
from vo.base.errors import OutputError, VoError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.base.option_names import Flag, with_flags
from vo.runs.batch.fingerprint import fingerprint
from vo.runs.batch.job import Job, JobResult, JobStatus
from vo.runs.batch.worker import RESULT, write_result

FAILED, WORK = "failed", ".vo-batch-work"
LOG, REPORT = "log.txt", "report.html"
_log = logging.getLogger(__name__)
_POLL_S = 0.25  # until a request to stop is obeyed
_GRACE_S = 5.0  # for a process to save its results after SIGINT
_PROGRAM = """
import sys
sys.path[:], sys.modules["scipy"] = {path!r}, None
from vo.runs.batch.worker import main
main()
"""


@dataclass(frozen=True)
class Limits:
    """What a job may use.

    Attributes:
        threads: cores.
        timeout_s: time for one attempt, None for any.
        memory_mb: address space of its process, None for any.
        retries: further attempts after a crash or a timeout.
        has_report: whether each finished run gets a `report.html` too.
        flags: how a command line gives options; messages name them so.
    """

    threads: int = 2
    timeout_s: float | None = None
    memory_mb: int | None = None
    retries: int = 1
    has_report: bool = False
    flags: Mapping[str, Flag] = field(default_factory=dict)


def kept_result(job: Job, output: Path) -> JobResult | None:
    """The finished result of the same input, settings and versions, if there is one."""
    result = read_result(output / job.name)
    if result is None or not result.is_done:
        return None
    try:
        identity = fingerprint(job, load_config(job.config, job.overrides))
    except (VoError, OSError):
        return None  # the run will say what is wrong
    return replace(result, tags=job.tags) if result.fingerprint == identity else None


def read_result(folder: Path) -> JobResult | None:
    """The result in a folder; None if there is none that can be read."""
    try:
        return JobResult.from_dict(load_json(read_text(folder / RESULT)))
    except (OSError, ValueError, TypeError, KeyError):
        return None


def run_job(
    job: Job, output: Path, limits: Limits, is_stopped: Callable[[], bool] = lambda: False
) -> JobResult:
    """Run a job, again after a crash; its results are then in the folder of its name.

    What a failed attempt leaves, such as the path until then and a log, is in `failed/NAME`.
    Folders of these names that are not results of a batch stay as they are: the job fails.

    Raises:
        OutputError: nothing can be written to the output folder.
    """
    kept = kept_result(job, output)
    if kept is not None:
        if lacks_report(job, output, limits):
            _write_report(output / job.name)
        return kept
    for folder in (output / job.name, output / FAILED / job.name):
        if _is_foreign(folder):
            error = (
                f"{folder} is not a result of an earlier batch and is not replaced; "
                "move it away, or choose another `output`"
            )
            return JobResult(
                job.name,
                job.source,
                JobStatus.FAILED,
                with_flags(error, limits.flags),
                tags=job.tags,
            )
    for attempt in range(1, limits.retries + 2):
        try:
            (output / WORK).mkdir(parents=True, exist_ok=True)
            folder = Path(mkdtemp(prefix=f"{job.name[:80]}.", dir=output / WORK))
            folder.chmod(0o755)
            result = replace(_attempt(job, folder, limits, is_stopped), attempts=attempt)
            write_result(folder, result)
            _move(folder, output, result)
        except OSError as error:
            raise OutputError(f"{output} cannot be written: {error.strerror or error}") from error
        if result.status not in (JobStatus.CRASHED, JobStatus.TIMED_OUT):
            break
    if lacks_report(job, output, limits) and result.is_done:
        _write_report(output / job.name)
    return result


def _is_foreign(folder: Path) -> bool:
    """Whether there is something that is neither a result of a job nor an empty folder."""
    if folder.is_dir() and not any(folder.iterdir()):
        return False
    return os.path.lexists(folder) and read_result(folder) is None


def lacks_report(job: Job, output: Path, limits: Limits) -> bool:
    """Whether a report is asked for that the folder of a job does not have."""
    return limits.has_report and not (output / job.name / REPORT).exists()


def _write_report(folder: Path) -> None:
    """Write `report.html`; a run without one is still done."""
    command = [sys.executable, "-P", "-m", "vo", "report", str(folder), "--quiet"]
    ended = subprocess.run(command, capture_output=True, text=True, env=_environment())
    if ended.returncode != 0:
        lines = ended.stderr.strip().splitlines() or [f"status {ended.returncode}"]
        _log.warning("%s has no report: %s", folder, lines[-1].removeprefix("error: "))


def _move(folder: Path, output: Path, result: JobResult) -> None:
    """Give results their final name; those of an earlier run are replaced at once."""
    failed = output / FAILED / result.name
    if result.status is JobStatus.NOT_RUN:
        shutil.rmtree(folder, ignore_errors=True)
        return
    target = output / result.name if result.is_done else failed
    target.parent.mkdir(parents=True, exist_ok=True)
    if result.is_done and failed.exists():
        shutil.rmtree(failed, ignore_errors=True)
    if target.exists():
        old = folder.with_name(folder.name + ".old")
        os.rename(target, old)
        os.rename(folder, target)
        shutil.rmtree(old, ignore_errors=True)
    else:
        os.rename(folder, target)


def _attempt(job: Job, folder: Path, limits: Limits, is_stopped: Callable[[], bool]) -> JobResult:
    unfinished = JobResult(job.name, job.source, JobStatus.NOT_RUN, tags=job.tags)
    if is_stopped():
        return unfinished
    request = {
        "job": job.to_dict(),
        "folder": str(folder),
        "threads": limits.threads,
        "memory_mb": limits.memory_mb,
        "flags": limits.flags,
    }
    with (folder / LOG).open("wb") as log:
        process = _started(log.fileno())
        assert process.stdin is not None and process.stdout is not None
        with process.stdin, process.stdout:
            _send(process.stdin, json.dumps(request).encode() + b"\n")
            ended = _wait(process, limits.timeout_s, is_stopped)
    if ended == "stopped":
        return unfinished
    if ended == "timed out":
        limit = f"{limits.timeout_s:g} s"
        error = f"it took more than {limit} (`timeout_s`); it may wait for something for ever"
        return replace(
            unfinished, status=JobStatus.TIMED_OUT, error=with_flags(error, limits.flags)
        )
    result = read_result(folder)
    if result is not None and process.returncode == 0:
        if result.is_done and (folder / LOG).stat().st_size == 0:
            (folder / LOG).unlink()
        return result
    return replace(unfinished, status=JobStatus.CRASHED, error=_why(process.returncode, folder))


def _started(log: int) -> subprocess.Popen[bytes]:
    package = str(Path(__file__).resolve().parents[3])
    path = [*dict.fromkeys([*filter(os.path.isabs, sys.path), package])]
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _PROGRAM.format(path=path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,  # closed by its end, which wakes the batch up
        bufsize=0,
        stderr=log,
        env=_environment(),
        process_group=0,  # Ctrl-C in a terminal is sent to a whole group
    )


def _environment() -> dict[str, str]:
    """Variables of `vo run`, so that results have the same bytes; workers of Ray lack them."""
    environment = dict(os.environ)
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
    environment.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))
    environment.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    use_common_instructions(environment)
    return environment


def _send(pipe: IO[bytes], request: bytes) -> None:
    """Write to a pipe without a buffer, which would be written again when it is closed."""
    with suppress(BrokenPipeError):  # the process has ended already
        while request:
            request = request[pipe.write(request) :]


def _wait(
    process: subprocess.Popen[bytes], timeout_s: float | None, is_stopped: Callable[[], bool]
) -> str:
    """Wait for the end of a process, or end it: `ended`, `timed out` or `stopped`."""
    assert process.stdout is not None
    end = float("inf") if timeout_s is None else time.monotonic() + timeout_s
    try:
        while True:
            left = end - time.monotonic()
            ready, _, _ = select.select([process.stdout], [], [], max(0.0, min(_POLL_S, left)))
            if ready and not os.read(process.stdout.fileno(), 1 << 16):
                process.wait()
                return "ended"
            if is_stopped():
                return "stopped"
            if time.monotonic() >= end:
                process.send_signal(signal.SIGINT)  # the path until now is written
                with suppress(subprocess.TimeoutExpired):
                    process.wait(_GRACE_S)
                return "timed out"
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def _why(status: int, folder: Path) -> str:
    """One line about a process that ended without a result."""
    if status < 0:
        name = signal.Signals(-status).name if -status in set(signal.Signals) else str(-status)
        memory = ", perhaps by the system because memory was short" if name == "SIGKILL" else ""
        return f"its process was ended by {name}{memory}"
    try:
        lines = (folder / LOG).read_text("utf-8", "replace").strip().splitlines()
    except OSError:
        lines = []
    last = " ".join(lines[-1].split()) if lines else "no message"
    return f"its process ended with status {status}: {last}"[:500]
