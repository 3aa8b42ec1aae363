"""A batch: all jobs of a plan, their results as they come, and the files about all of them."""

from __future__ import annotations

import fcntl
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from vo.base.errors import OutputError, SourceError
from vo.base.scheduling import available_cores
from vo.runs.batch.execution import (
    FAILED,
    WORK,
    Limits,
    kept_result,
    lacks_report,
    read_result,
    run_job,
)
from vo.runs.batch.job import Job, JobResult, JobStatus
from vo.runs.batch.planning import Plan
from vo.runs.batch.tables import PAGE, SUMMARY, TABLE, read_batch, write_tables

_REFRESH_S = 5.0  # minimum time between tables on the way
_REFRESH_RATIO = 0.05  # maximum ratio of the time that they take


class BatchProgress(Protocol):
    """Observer of a batch."""

    def begin(self, total: int) -> None:
        """Before the first job."""

    def step(self, result: JobResult, done: int, *, is_kept: bool) -> None:
        """After each job."""

    def finish(self) -> None:
        """After the last one, also when the batch is interrupted."""


class Engine(Protocol):
    """Runs jobs somewhere."""

    limits: Limits

    def results(self, jobs: list[Job], output: Path) -> Iterator[JobResult]:
        """Run all jobs; their results as they come, in any order.

        An exception, such as a KeyboardInterrupt, ends the jobs that run.
        """
        ...


@dataclass(frozen=True)
class BatchResult:
    """Results of all jobs, in the order of the plan."""

    output: Path
    results: tuple[JobResult, ...]
    wall_s: float
    kept: int
    is_interrupted: bool = False

    @property
    def unfinished(self) -> tuple[JobResult, ...]:
        """Results of jobs that are not done."""
        return tuple(result for result in self.results if not result.is_done)


class LocalEngine:
    """Runs jobs in processes of this machine, which together use all its cores.

    Without `jobs`, one runs on two cores.
    """

    def __init__(self, jobs: int | None, limits: Limits) -> None:
        cores = available_cores()
        self.jobs = max(1, cores // 2) if jobs is None else jobs
        self.limits = replace(limits, threads=max(1, cores // self.jobs))

    def results(self, jobs: list[Job], output: Path) -> Iterator[JobResult]:
        """Run all jobs; their results as they come."""
        stop = threading.Event()
        with ThreadPoolExecutor(self.jobs) as pool:
            waiting: set[Future[JobResult]] = set()
            following = iter(jobs)
            try:
                while True:
                    for job in following:
                        waiting.add(pool.submit(run_job, job, output, self.limits, stop.is_set))
                        if len(waiting) >= 2 * self.jobs:
                            break
                    if not waiting:
                        return
                    done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield future.result()
            finally:
                stop.set()
                for future in waiting:
                    future.cancel()


def run_batch(
    plan: Plan, output: Path, engine: Engine, progress: BatchProgress | None = None
) -> BatchResult:
    """Run all jobs of a plan that have no finished result yet.

    The folder has a folder of results for each job (`NAME`, and `failed/NAME` for what failed),
    `batch.json`, `batch.csv` and `index.html`.

    Raises:
        OutputError: the folder cannot be written, another batch is writing there, or it has files
            of others with the names of results.
    """
    begun = time.monotonic()
    with _locked(output), _observed(progress, len(plan.jobs)) as step:
        _refuse_foreign_files(output)
        shutil.rmtree(output / WORK, ignore_errors=True)  # of a batch that was killed
        found: dict[str, JobResult] = {}
        complete = [job for job in plan.jobs if not lacks_report(job, output, engine.limits)]
        for result in _kept(complete, output):
            found[result.name] = result
            step(result, len(found), is_kept=True)
        kept = len(found)
        tables = _Tables(plan, output)
        is_interrupted = False
        missing = [job for job in plan.jobs if job.name not in found]
        try:
            for result in engine.results(missing, output):
                found[result.name] = result
                step(result, len(found), is_kept=False)
                tables.refresh(found)
        except KeyboardInterrupt:
            is_interrupted = True
            ended = _kept([job for job in missing if job.name not in found], output)
            found |= {result.name: result for result in ended}
        shutil.rmtree(output / WORK, ignore_errors=True)
        tables.write(found)
        return BatchResult(
            output,
            tuple(_result(job, found, output) for job in plan.jobs),
            time.monotonic() - begun,
            kept,
            is_interrupted,
        )


def _kept(jobs: Sequence[Job], output: Path) -> Iterator[JobResult]:
    """Finished results of jobs, of an earlier batch too."""
    for job in jobs:
        result = kept_result(job, output)
        if result is not None:
            yield result


class _Tables:
    """The tables of a batch on the way, written every few seconds, less often if it takes long."""

    def __init__(self, plan: Plan, output: Path) -> None:
        self._plan = plan
        self._output = output
        self._due = time.monotonic() + _REFRESH_S

    def refresh(self, found: dict[str, JobResult]) -> None:
        """Write the tables if they are due."""
        begun = time.monotonic()
        if begun >= self._due:
            self.write(found)
            now = time.monotonic()
            self._due = now + max(_REFRESH_S, (now - begun) / _REFRESH_RATIO)

    def write(self, found: dict[str, JobResult]) -> None:
        """Write the tables."""
        results = [_result(job, found, self._output) for job in self._plan.jobs]
        write_tables(self._output, results, self._plan)


def _result(job: Job, found: dict[str, JobResult], output: Path) -> JobResult:
    result = found.get(job.name)
    if result is None or result.status is JobStatus.NOT_RUN:
        earlier = read_result(output / FAILED / job.name)  # of an earlier batch
        waiting = JobResult(job.name, job.source, JobStatus.NOT_RUN, tags=job.tags)
        return waiting if earlier is None or earlier.source != job.source else earlier
    return result


def _refuse_foreign_files(output: Path) -> None:
    """A batch writes `batch.json` first: other tables without it are not results of one."""
    found = [output / name for name in (SUMMARY, TABLE, PAGE) if (output / name).exists()]
    if not found:
        return
    try:
        read_batch(output)
    except SourceError as error:
        raise OutputError(
            f"{found[0]} is not a result of an earlier batch and would be replaced; "
            "choose another `output`"
        ) from error


@contextmanager
def _observed(progress: BatchProgress | None, total: int) -> Iterator[Callable[..., None]]:
    if progress is None:
        yield lambda *_, **__: None
        return
    progress.begin(total)
    try:
        yield progress.step
    finally:
        progress.finish()


@contextmanager
def _locked(output: Path) -> Iterator[None]:
    """Lock the folder against other batches; create it if it is missing."""
    try:
        output.mkdir(parents=True, exist_ok=True)
        folder = os.open(output, os.O_RDONLY)
    except OSError as error:
        raise OutputError(
            f"cannot write to folder {output}: {error.strerror or error}; choose another `output`"
        ) from error
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OutputError(
                f"another batch is writing to {output}; choose another `output`"
            ) from error
        except OSError:
            pass  # a network file system without locks
        yield
    finally:
        os.close(folder)
