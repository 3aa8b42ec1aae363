"""Jobs as tasks of Ray, on this machine or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vo.base.errors import ConfigError
from vo.base.extras import require
from vo.base.printable import one_line
from vo.runs.batch.execution import Limits, run_job
from vo.runs.batch.job import Job, JobResult, JobStatus

_POLL_S = 0.5  # until machines that have joined are used
_AHEAD = 4  # tasks that wait, by core of the cluster


class RayEngine:
    """Runs each job as a task of Ray; a task whose worker or machine dies is run elsewhere.

    All machines need this package, the recordings, and the output folder under the same path,
    such as a network file system; recordings may also be URLs.

    Args:
        address: `auto` for the cluster of this machine, `local` for a new one on its cores, or
            `HOST:PORT` or `ray://HOST:PORT` of another.
        limits: of each job; its threads are the cores that Ray reserves.

    Raises:
        MissingExtraError: Ray is not installed.
        ConfigError: there is no cluster at the address.
    """

    def __init__(self, address: str, limits: Limits) -> None:
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        self._ray: Any = require("ray", extra="cluster", what="batches on a cluster")
        self.limits = limits
        self._address = address
        self._connect()

    def _connect(self) -> None:
        options: dict[str, Any] = {"log_to_driver": False, "include_dashboard": False}
        if self._address != "local":
            options = {"log_to_driver": False, "address": self._address}
        try:
            self._ray.init(ignore_reinit_error=True, configure_logging=False, **options)
        except (ConnectionError, ValueError, RuntimeError) as error:
            reason = one_line(str(error))[:300]
            raise ConfigError(
                f"no Ray cluster at {self._address}: {reason}; start one with `ray start --head`"
            ) from error

    @property
    def cores(self) -> int:
        """Cores of the cluster at present."""
        return int(self._ray.cluster_resources().get("CPU", 1))

    def results(self, jobs: list[Job], output: Path) -> Iterator[JobResult]:
        """Run all jobs; their results as they come."""
        ray, limits = self._ray, self.limits
        resources: dict[str, Any] = {"num_cpus": limits.threads, "max_retries": limits.retries + 2}
        if limits.memory_mb is not None:
            resources["memory"] = limits.memory_mb << 20
        task = ray.remote(**resources)(run_job)
        waiting: dict[Any, Job] = {}
        following = iter(jobs)
        output = output.absolute()
        try:
            while True:
                room = _AHEAD * max(1, self.cores // limits.threads) - len(waiting)
                for _, job in zip(range(room), following, strict=False):
                    waiting[task.remote(job, output, limits)] = job
                if not waiting:
                    return
                done, _ = ray.wait(list(waiting), num_returns=1, timeout=_POLL_S)
                for reference in done:
                    yield self._result(reference, waiting.pop(reference))
        finally:
            for reference in waiting:
                ray.cancel(reference, force=True)

    def _result(self, reference: Any, job: Job) -> JobResult:
        try:
            return JobResult.from_dict(self._ray.get(reference).to_dict())
        except self._ray.exceptions.RayError as error:
            reason = one_line(f"{type(error).__name__}: {error}")[:300]
            crashed = JobStatus.CRASHED
            return JobResult(job.name, job.source, crashed, f"Ray: {reason}", tags=job.tags)
