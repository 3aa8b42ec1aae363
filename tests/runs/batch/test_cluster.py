"""Batches on a Ray cluster of two nodes, one of which is killed."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from vo.runs.batch.batch import LocalEngine, run_batch
from vo.runs.batch.execution import Limits
from vo.runs.batch.job import Job, JobStatus
from vo.runs.batch.planning import plan
from vo.runs.batch.tables import read_batch

VO = Path(sys.executable).with_name("vo")
FILES = ("trajectory.tum", "causal.tum", "poses.csv", "covariance.csv")


def test_a_batch_survives_the_death_of_a_node(walks: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="ray is not installed; call scripts/setup dev")
    from ray_cluster import cluster

    output = tmp_path / "out"
    command = [VO, "batch", walks, "-o", output, "--config", "fast", "--threads", "1"]
    with cluster(nodes=2, cpus=1) as running:
        process = subprocess.Popen(
            [*command, "--ray", "auto"],
            env=running.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        end = time.monotonic() + 90.0
        while len(list((output / ".vo-batch-work").glob("*"))) < 2:  # a task on each node
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.02)
        running.kill(1)
        printed, _ = process.communicate(timeout=120)
    assert process.returncode == 0, printed
    assert [each.status for each in read_batch(output)] == [JobStatus.DONE] * 3
    planned = plan([str(walks / "walk0"), str(walks / "walk1")], Job("", "", "fast"))
    run_batch(planned, tmp_path / "alone", LocalEngine(2, Limits()))
    for name in ("walk0", "walk1"):
        for file in FILES:
            assert (output / name / file).read_bytes() == (
                tmp_path / "alone" / name / file
            ).read_bytes()
